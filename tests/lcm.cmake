# The loop over LCM in one process: memq://, no network.
add_executable(test_lcm_memq hil/test_lcm_memq.cpp $<TARGET_OBJECTS:lpvg_catch_main>)
target_link_libraries(test_lcm_memq PRIVATE lpvguard_sim_loop Catch2::Catch2)
target_compile_features(test_lcm_memq PRIVATE cxx_std_17)
target_compile_definitions(test_lcm_memq PRIVATE LPVGUARD_TRUCK_TOML="${PROJECT_SOURCE_DIR}/firmware_sim/plant/truck.toml")
target_compile_options(test_lcm_memq PRIVATE -Wall -Wextra -Werror)
add_test(NAME hil.lcm_memq COMMAND test_lcm_memq)
set_tests_properties(hil.lcm_memq PROPERTIES LABELS hil TIMEOUT 120)
