# The C and C++ tests of the CAN part, on a codec generated here: they hold for every vehicle and need none.
set(can_codec "${CMAKE_CURRENT_BINARY_DIR}/can_codec")
file(MAKE_DIRECTORY "${can_codec}")
execute_process(COMMAND ${lpvg_python} -c "import sys, pathlib
from lpvguard.can.codegen import codec_files
for name, text in codec_files().items():
    path = pathlib.Path(sys.argv[1], name)
    if not path.is_file() or path.read_text() != text:  # what is as it was is not compiled again
        path.write_text(text)" "${can_codec}" COMMAND_ERROR_IS_FATAL ANY)
file(GLOB can_package "${PROJECT_SOURCE_DIR}/tools/src/lpvguard/can/*.py" "${PROJECT_SOURCE_DIR}/tools/src/lpvguard/can/*.toml")
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${can_package})

set(can_sources "${PROJECT_SOURCE_DIR}/lib/src/guard/can.cpp" "${PROJECT_SOURCE_DIR}/lib/src/services/j1939.cpp" "${PROJECT_SOURCE_DIR}/lib/src/services/uds.cpp"
  "${PROJECT_SOURCE_DIR}/lib/src/services/xcp.cpp" "${can_codec}/lpvg_can_codec.c")
set(can_includes "${PROJECT_SOURCE_DIR}/lib/include" "${PROJECT_SOURCE_DIR}/lib/src" "${can_codec}")

# With sanitizers in every build: these tests look for undefined behaviour, not for speed.
set(can_sanitize "")
if(NOT LPVG_SANITIZE AND NOT LPVG_COVERAGE AND NOT CMAKE_CROSSCOMPILING)
  set(can_sanitize -fsanitize=address,undefined -fno-sanitize-recover=all)
endif()
add_library(can_under_test STATIC ${can_sources})
set_target_properties(can_under_test PROPERTIES C_STANDARD 99 C_EXTENSIONS OFF CXX_STANDARD 17 CXX_EXTENSIONS OFF)
target_include_directories(can_under_test PUBLIC ${can_includes})
target_compile_options(can_under_test PRIVATE -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow -Werror
  $<$<COMPILE_LANGUAGE:CXX>:-fno-exceptions;-fno-rtti> PUBLIC ${can_sanitize})
target_link_options(can_under_test PUBLIC ${can_sanitize})

foreach(test IN ITEMS unit/test_can unit/test_j1939 unit/test_uds unit/test_hostile_bus fault/test_can_faults)
  cmake_path(GET test FILENAME program)
  cmake_path(GET test PARENT_PATH kind)
  string(REPLACE "test_" "" name ${program})
  add_executable(${program} ${test}.cpp)
  target_link_libraries(${program} PRIVATE can_under_test lpvg_catch)
  add_test(NAME ${kind}.${name} COMMAND ${program})
  set_tests_properties(${kind}.${name} PROPERTIES LABELS ${kind} TIMEOUT 120)
  lpvg_counted(${kind}.${name} ${program})
endforeach()
foreach(target IN ITEMS unit_tests sanitized_tests)
  add_dependencies(${target} test_can test_j1939 test_uds test_hostile_bus)
endforeach()
set_property(TEST unit.can unit.j1939 unit.uds unit.hostile_bus APPEND PROPERTY LABELS core_unit sanitized)

# The committed corpus, then three million random frames. With clang there is `fuzz_can` too, for a campaign:
#     fuzz_can -runs=10200000 -max_len=160 -seed=7 CORPUS_OF_YOUR_OWN tests/fuzz/corpus/can
# The newest: 10.4 million sequences, about 1.4e9 frames, no finding. Of the branches that a frame can take through lpvg_can_receive
# and lpvg_can_advance the corpus takes all but those for NULL, rules without limits, and the absent last bytes of a frame.
file(GLOB can_corpus "${CMAKE_CURRENT_SOURCE_DIR}/fuzz/corpus/can/*")
add_executable(fuzz_can_replay fuzz/fuzz_can.cpp)
target_compile_definitions(fuzz_can_replay PRIVATE LPVG_FUZZ_REPLAY)
target_compile_features(fuzz_can_replay PRIVATE cxx_std_17)
target_link_libraries(fuzz_can_replay PRIVATE can_under_test)
add_test(NAME fuzz.can_short COMMAND fuzz_can_replay 1 20000 ${can_corpus})
set_tests_properties(fuzz.can_short PROPERTIES LABELS fuzz TIMEOUT 120)
if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang" AND CMAKE_C_COMPILER_ID STREQUAL "Clang" AND can_sanitize)
  add_executable(fuzz_can ${can_sources} fuzz/fuzz_can.cpp)
  target_include_directories(fuzz_can PRIVATE ${can_includes})
  target_compile_features(fuzz_can PRIVATE cxx_std_17)
  target_compile_options(fuzz_can PRIVATE -fsanitize=fuzzer-no-link ${can_sanitize})
  target_link_options(fuzz_can PRIVATE -fsanitize=fuzzer ${can_sanitize})
endif()

# A real vcan0. Without AddressSanitizer, under which user-mode Linux ends a program.
if(CMAKE_SYSTEM_NAME STREQUAL "Linux" AND can_sanitize)
  lpvg_missing(without_vcan uml candump cangen cansend ip)
  add_executable(test_socketcan hil/test_socketcan.cpp "${PROJECT_SOURCE_DIR}/firmware_sim/ports/linux/socketcan.cpp"
    ${can_sources})
  target_include_directories(test_socketcan PRIVATE ${can_includes})
  target_link_libraries(test_socketcan PRIVATE lpvg_catch)
  target_compile_options(test_socketcan PRIVATE -Wall -Wextra)
  set_property(GLOBAL APPEND PROPERTY lpvg_slow_programs test_socketcan)
  if(without_vcan)
    lpvg_skipped_test(hil.socketcan hil "${without_vcan}")
  else()
    add_test(NAME hil.socketcan COMMAND "${PROJECT_SOURCE_DIR}/tools/with-vcan" $<TARGET_FILE:test_socketcan>)
    # In real time: what else the machine does must not be read as lost frames.
    set_tests_properties(hil.socketcan PROPERTIES LABELS "hil;slow" TIMEOUT 180 RUN_SERIAL ON SKIP_REGULAR_EXPRESSION "with-vcan: no AF_CAN here")
  endif()
endif()
