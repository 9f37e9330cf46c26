# find_package(lpvguard): the core's sources and the function that builds a vehicle from them. No size-dependent binary is
# installed. lpvguard_VEHICLES_DIR holds the generated folders that are shipped.
set(lpvguard_VEHICLES_DIR "${CMAKE_CURRENT_LIST_DIR}/vehicles")
include("${CMAKE_CURRENT_LIST_DIR}/lpvguardAddVehicle.cmake")
