# The loop over LCM in one process: memq://, no network.
add_executable(test_lcm_memq hil/test_lcm_memq.cpp)
target_link_libraries(test_lcm_memq PRIVATE lpvguard_sim_loop lpvg_catch)
target_compile_definitions(test_lcm_memq PRIVATE LPVGUARD_TRUCK_TOML="${PROJECT_SOURCE_DIR}/firmware_sim/plant/truck.toml")
target_compile_options(test_lcm_memq PRIVATE -Wall -Wextra -Werror)
add_test(NAME hil.lcm_memq COMMAND test_lcm_memq)
set_tests_properties(hil.lcm_memq PROPERTIES LABELS "hil;slow" TIMEOUT 120)  # 12 s: the simulator is compiled for it
set_property(GLOBAL APPEND PROPERTY lpvg_slow_programs test_lcm_memq)
