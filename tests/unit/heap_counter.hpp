/// @file heap_counter.hpp -- counts heap allocations, to prove that a call makes none.
///
/// Linking heap_counter.cpp into a test program replaces operator new for the whole program.
#pragma once

/// Calls of operator new since the program started, all threads.
long heap_allocations();
