/// @file catch_main.cpp -- main() of every Catch2 test program of the project; kept apart because it compiles slowly.
#define CATCH_CONFIG_RUNNER
#include "../catch.hpp"

int main(int argc, char* argv[]) { return Catch::Session().run(argc, argv); }
