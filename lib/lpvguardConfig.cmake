# find_package(lpvguard): the core's sources and the function that builds a vehicle from them. No size-dependent binary is
# installed. lpvguard_VEHICLES_DIR holds the generated folders that are shipped.
get_property(lpvguard_languages GLOBAL PROPERTY ENABLED_LANGUAGES)
if(NOT "CXX" IN_LIST lpvguard_languages)
  set(lpvguard_FOUND FALSE)
  set(lpvguard_NOT_FOUND_MESSAGE "the core is built from C++ sources, so CXX must be enabled: project(NAME LANGUAGES C CXX)")
  return()
endif()
set(lpvguard_VEHICLES_DIR "${CMAKE_CURRENT_LIST_DIR}/vehicles")
include("${CMAKE_CURRENT_LIST_DIR}/lpvguardAddVehicle.cmake")
