# Catch2 2 or 3: tests/catch.hpp includes the one that is there.
find_package(Catch2 2 QUIET)
if(NOT Catch2_FOUND)
  find_package(Catch2 3 REQUIRED)
endif()

# main() of every test program, compiled once; the gates give their builds that of the build that they run in. Catch2 itself is not what
# optimisation and sanitizers are for; with them it takes longer to compile than all the rest.
set(LPVG_CATCH_MAIN "" CACHE FILEPATH "main() of the test programs as an object of this machine; empty: it is compiled")
set(lpvg_catch_main "${LPVG_CATCH_MAIN}")
if(NOT lpvg_catch_main)
  add_library(lpvg_catch_main OBJECT "${CMAKE_CURRENT_LIST_DIR}/unit/catch_main.cpp")
  target_link_libraries(lpvg_catch_main PUBLIC Catch2::Catch2)
  target_compile_features(lpvg_catch_main PUBLIC cxx_std_17)
  target_compile_options(lpvg_catch_main PRIVATE -O0 $<$<BOOL:${LPVG_SANITIZE}>:-fno-sanitize=all>)
  set(lpvg_catch_main $<TARGET_OBJECTS:lpvg_catch_main>)
endif()

# How a test program's own code is compiled: not optimised, and without the checks of undefined behaviour and the counters, because what it
# tests is compiled apart. Its arrays keep the address sanitizer.
set(lpvg_test_options -O0 -fno-sanitize=undefined,float-divide-by-zero,float-cast-overflow)
if(LPVG_COVERAGE)
  list(APPEND lpvg_test_options -fno-profile-instr-generate -fno-coverage-mapping -fno-coverage-mcdc -g0)
endif()

# lpvg_catch: what a test program links. One whose own code is what it tests, because that is a header, has the property lpvg_tests_header.
add_library(lpvg_catch INTERFACE)
target_sources(lpvg_catch INTERFACE ${lpvg_catch_main})
target_link_libraries(lpvg_catch INTERFACE Catch2::Catch2)
target_compile_features(lpvg_catch INTERFACE cxx_std_17)
# Where there is a quicker linker than the default: with sanitizers and counts a program takes 0.3 s for 0.8.
include(CheckLinkerFlag)
foreach(linker IN ITEMS lld gold)
  check_linker_flag(CXX -fuse-ld=${linker} lpvg_links_by_${linker})
  if(lpvg_links_by_${linker})
    target_link_options(lpvg_catch INTERFACE -fuse-ld=${linker})
    break()
  endif()
endforeach()
target_compile_options(lpvg_catch INTERFACE "$<$<NOT:$<BOOL:$<TARGET_PROPERTY:lpvg_tests_header>>>:${lpvg_test_options}>")

# lpvg_counted(TEST PROGRAM): with LPVG_COVERAGE the test leaves its counts beside its program.
function(lpvg_counted test program)
  if(LPVG_COVERAGE)
    set_property(TEST ${test} APPEND PROPERTY ENVIRONMENT "LLVM_PROFILE_FILE=$<TARGET_FILE:${program}>.profraw")
  endif()
endfunction()
