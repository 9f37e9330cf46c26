# Catch2 2 or 3: tests/catch.hpp includes the one that is there.
find_package(Catch2 2 QUIET)
if(NOT Catch2_FOUND)
  find_package(Catch2 3 REQUIRED)
endif()
