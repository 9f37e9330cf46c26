# lpvguard_add_vehicle(NAME DIR [SERVICES SERVICE...]): the C core of one vehicle, from lpvguard's sources and the vehicle's generated folder.
#
# Makes the static library lpvguard_NAME, alias lpvguard::NAME; its public symbols start with lpvg_NAME_, so that several
# vehicles link into one image. A user of the target needs C99 only: C++17 and Eigen 3.4 stay inside it.
#
#   NAME  as in DIR/lpvguard_vehicle.h (LPVG_VEHICLE)
#   DIR   written by `lpvguard export`: lpvguard_vehicle.h, lpvguard_coeff.c; with a controller also lpvguard_control.c,
#         lpvguard_bus.c and the CAN codec, and then the target has ecu.h, controller.h and can.h too; with demands on the car's own bus also
#         lpvg_demand.c
#   SERVICE  a source of src/services without its ending, or ALL: diagnosis, evidence, isolation, life; with a controller also authentication, j1939, uds, xcp.
#            Nothing of the core calls a service.
#
# LPVG_DOUBLE, when set, makes lpvg_real_t double; set it before the first vehicle, for the whole image.
# Warnings are errors here; `cmake --compile-no-warning-as-error` lifts that for a compiler that knows new ones.
include_guard(GLOBAL)

set_property(GLOBAL PROPERTY LPVG_CORE_ROOT "${CMAKE_CURRENT_LIST_DIR}")

# lpvguard_compile(TARGET): what the sources are compiled with, whatever builds them. -fno-math-errno: a square root is one instruction
# and no global state is written. Sizes are fixed, so that Eigen's assertions prove nothing, and would import abort and stdio into an
# unoptimised build.
function(lpvguard_compile TARGET)
  target_compile_features(${TARGET} PRIVATE cxx_std_17)
  target_compile_options(${TARGET} PRIVATE -fno-math-errno $<$<COMPILE_LANGUAGE:CXX>:-fno-exceptions;-fno-rtti>)
  target_compile_definitions(${TARGET} PRIVATE EIGEN_NO_DEBUG)
endfunction()

# lpvguard_sources(DIR OUT SERVICE...): the core's sources that the vehicle of DIR needs, those of the services, and its own.
function(lpvguard_sources DIR OUT)
  get_property(root GLOBAL PROPERTY LPVG_CORE_ROOT)
  foreach(file IN ITEMS lpvguard_vehicle.h lpvguard_coeff.c)
    if(NOT EXISTS "${DIR}/${file}")
      message(FATAL_ERROR "lpvguard: ${DIR}/${file} is missing; `lpvguard export` writes it")
    endif()
  endforeach()
  set(parts monitor/change monitor/coeff monitor/energy monitor/model monitor/monitor)
  set(own lpvguard_coeff.c)
  set(services diagnosis evidence isolation life)
  if(EXISTS "${DIR}/lpvguard_control.c")
    list(APPEND parts guard/controller)
    list(APPEND own lpvguard_control.c)
  endif()
  if(EXISTS "${DIR}/lpvg_demand.c")
    list(APPEND own lpvg_demand.c)
  endif()
  if(EXISTS "${DIR}/lpvguard_bus.c")
    # can, the services but diagnosis, and the codec depend on no vehicle: in an image of several vehicles the linker takes the first one's.
    list(APPEND parts monitor/watch guard/can guard/ecu)
    list(APPEND own lpvguard_bus.c lpvg_can_codec.c)
    list(APPEND services authentication j1939 uds xcp)
  endif()
  set(asked ${ARGN})
  if("${asked}" STREQUAL ALL)
    set(asked ${services})
  endif()
  foreach(service IN LISTS asked)
    if(NOT service IN_LIST services)
      message(FATAL_ERROR "lpvguard: ${service} is no service of ${DIR}; expected ALL or some of ${services}")
    endif()
    list(APPEND parts services/${service})
  endforeach()
  foreach(service IN ITEMS diagnosis isolation)
    if(${service} IN_LIST asked AND EXISTS "${DIR}/lpvguard_${service}.c")
      list(APPEND own lpvguard_${service}.c)
    endif()
  endforeach()
  list(TRANSFORM parts REPLACE "(.+)" "${root}/src/\\1.cpp")
  list(TRANSFORM own PREPEND "${DIR}/")
  set(${OUT} ${parts} ${own} PARENT_SCOPE)
endfunction()

function(lpvguard_add_vehicle NAME DIR)
  get_property(root GLOBAL PROPERTY LPVG_CORE_ROOT)
  cmake_path(ABSOLUTE_PATH DIR NORMALIZE OUTPUT_VARIABLE folder)
  cmake_parse_arguments(PARSE_ARGV 2 arg "" "" SERVICES)
  if(arg_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "lpvguard_add_vehicle(${NAME}): ${arg_UNPARSED_ARGUMENTS}; expected SERVICES and their names")
  endif()
  lpvguard_sources("${folder}" sources ${arg_SERVICES})
  # A library whose symbols do not carry its name would collide with another one only at the user's link step.
  file(STRINGS "${folder}/lpvguard_vehicle.h" named REGEX "^#define LPVG_VEHICLE ${NAME}$")
  if(NOT named)
    message(FATAL_ERROR "lpvguard_add_vehicle(${NAME}): ${folder}/lpvguard_vehicle.h is of another vehicle")
  endif()

  find_package(Eigen3 3.4 REQUIRED NO_MODULE)
  get_target_property(eigen Eigen3::Eigen INTERFACE_INCLUDE_DIRECTORIES)

  set(target lpvguard_${NAME})
  add_library(${target} STATIC ${sources})
  add_library(lpvguard::${NAME} ALIAS ${target})
  target_include_directories(${target} PUBLIC "${root}/include" "${folder}")
  target_include_directories(${target} PRIVATE "${root}/src")
  target_include_directories(${target} SYSTEM PRIVATE ${eigen})
  set_target_properties(${target} PROPERTIES
    C_STANDARD 99 C_EXTENSIONS OFF CXX_STANDARD 17 CXX_STANDARD_REQUIRED ON CXX_EXTENSIONS OFF
    COMPILE_WARNING_AS_ERROR ON)
  target_compile_options(${target} PRIVATE -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow)
  lpvguard_compile(${target})
  if(LPVG_DOUBLE)
    target_compile_definitions(${target} PUBLIC LPVG_DOUBLE)
  endif()
endfunction()
