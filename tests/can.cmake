# The C and C++ tests of the CAN part; include() it after enable_testing() and find_package(Catch2).
# LPVG_CAN_CODEC_DIR: folder of the generated lpvg_can_codec.h and .c.
set(can_root ${CMAKE_CURRENT_LIST_DIR}/..)
set(can_strict -Wall -Wextra -Wconversion -Wdouble-promotion -Werror)
set(can_sanitize -fsanitize=address,undefined -fno-sanitize-recover=all)

# The core's part and the codec, with sanitizers: these tests look for undefined behaviour, not for speed.
add_library(can_under_test STATIC ${can_root}/lib/src/can.cpp ${LPVG_CAN_CODEC_DIR}/lpvg_can_codec.c)
target_compile_features(can_under_test PUBLIC cxx_std_17 c_std_99)
target_include_directories(can_under_test PUBLIC ${can_root}/lib/include ${LPVG_CAN_CODEC_DIR})
target_compile_options(can_under_test PRIVATE ${can_strict} $<$<COMPILE_LANGUAGE:CXX>:-fno-exceptions;-fno-rtti>
                                      PUBLIC -O1 ${can_sanitize})
target_link_options(can_under_test PUBLIC ${can_sanitize})

foreach(pair unit/test_can fault/test_can_faults)
  get_filename_component(name ${pair} NAME)
  get_filename_component(kind ${pair} DIRECTORY)
  add_executable(${name} ${can_root}/tests/${pair}.cpp ${can_root}/tests/unit/catch_main.cpp)
  target_link_libraries(${name} PRIVATE can_under_test Catch2::Catch2)
  add_test(NAME ${kind}.${name} COMMAND ${name})
  set_tests_properties(${kind}.${name} PROPERTIES LABELS ${kind})
endforeach()

# The committed corpus, then three million random frames. The campaign: tests/fuzz/fuzz_can.cpp says how.
file(GLOB can_corpus ${can_root}/tests/fuzz/corpus/can/*)
add_executable(fuzz_can_replay ${can_root}/tests/fuzz/fuzz_can.cpp)
target_compile_definitions(fuzz_can_replay PRIVATE LPVG_FUZZ_REPLAY)
target_link_libraries(fuzz_can_replay PRIVATE can_under_test)
add_test(NAME fuzz.can_short COMMAND fuzz_can_replay 1 20000 ${can_corpus})
set_tests_properties(fuzz.can_short PROPERTIES LABELS fuzz)

if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
  add_executable(fuzz_can ${can_root}/lib/src/can.cpp ${LPVG_CAN_CODEC_DIR}/lpvg_can_codec.c ${can_root}/tests/fuzz/fuzz_can.cpp)
  target_compile_features(fuzz_can PRIVATE cxx_std_17)
  target_include_directories(fuzz_can PRIVATE ${can_root}/lib/include ${LPVG_CAN_CODEC_DIR})
  target_compile_options(fuzz_can PRIVATE -O2 -g -fsanitize=fuzzer-no-link ${can_sanitize})
  target_link_options(fuzz_can PRIVATE -fsanitize=fuzzer ${can_sanitize})
endif()

# Linux: both buses. UML ends programs under AddressSanitizer, so this one goes without.
if(CMAKE_SYSTEM_NAME STREQUAL "Linux")
  add_executable(test_bus ${can_root}/tests/hil/test_bus.cpp ${can_root}/tests/unit/catch_main.cpp ${can_root}/lib/src/can.cpp
                          ${LPVG_CAN_CODEC_DIR}/lpvg_can_codec.c)
  target_include_directories(test_bus PRIVATE ${LPVG_CAN_CODEC_DIR})
  target_link_libraries(test_bus PRIVATE lpvguard_ports_linux Catch2::Catch2)
  add_test(NAME hil.bus_memory COMMAND test_bus "[bus]")
  add_test(NAME hil.bus_socketcan COMMAND ${can_root}/tools/with-vcan $<TARGET_FILE:test_bus> "[socketcan]")
  set_tests_properties(hil.bus_memory hil.bus_socketcan PROPERTIES LABELS hil)
endif()
