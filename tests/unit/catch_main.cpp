/// @file catch_main.cpp -- main() of every Catch2 test program of the project; kept apart because it compiles slowly.
#define CATCH_CONFIG_MAIN
#include <catch2/catch.hpp>
