// Empty: the target that compiles tests/catch.hpp ahead needs a source.
