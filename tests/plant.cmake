# Tests of the simulated truck, for the whole project and for firmware_sim/plant built alone.
set(unit_tests ${CMAKE_CURRENT_LIST_DIR}/unit)
add_executable(test_plant
  ${unit_tests}/heap_counter.cpp
  ${unit_tests}/test_plant_faults.cpp
  ${unit_tests}/test_plant_inputs.cpp
  ${unit_tests}/test_plant_motion.cpp)
target_link_libraries(test_plant PRIVATE lpvguard_plant lpvg_catch)
target_compile_definitions(test_plant PRIVATE LPVGUARD_TRUCK_TOML="${CMAKE_CURRENT_LIST_DIR}/../firmware_sim/plant/truck.toml")
target_compile_options(test_plant PRIVATE -Wall -Wextra -Wconversion -Wdouble-promotion -Werror -ffp-contract=off)
add_test(NAME unit.plant COMMAND test_plant)
add_test(NAME unit.plant_frequency_response COMMAND lpvguard_plant_tool frequency-response)
if(TARGET lpvguard::truck)  # the plant alone has no ECU
  foreach(name response random_responses)
    add_executable(test_${name} ${CMAKE_CURRENT_LIST_DIR}/fault/test_${name}.cpp ${unit_tests}/heap_counter.cpp)
    target_link_libraries(test_${name} PRIVATE lpvguard::truck lpvguard_plant lpvg_catch)
    target_compile_definitions(test_${name} PRIVATE LPVGUARD_TRUCK_TOML="${CMAKE_CURRENT_LIST_DIR}/../firmware_sim/plant/truck.toml"
      LPVG_REQUIREMENTS="${PROJECT_SOURCE_DIR}/lib/REQUIREMENTS.md")
    target_compile_options(test_${name} PRIVATE -Wall -Wextra -Werror -ffp-contract=off)
    add_test(NAME fault.${name} COMMAND test_${name})
    set_tests_properties(fault.${name} PROPERTIES LABELS "fault;slow" TIMEOUT 900)
    set_property(GLOBAL APPEND PROPERTY lpvg_slow_programs test_${name})
  endforeach()
endif()
set_tests_properties(unit.plant PROPERTIES LABELS "unit;slow")
set_tests_properties(unit.plant_frequency_response PROPERTIES LABELS "unit;slow;long")
set_property(GLOBAL APPEND PROPERTY lpvg_slow_programs test_plant)
