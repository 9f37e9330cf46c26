# lpvguard_add_vehicle(NAME DIR): the C core of one vehicle, from lpvguard's sources and the vehicle's generated folder.
#
# Makes the static library lpvguard_NAME, alias lpvguard::NAME; its public symbols start with lpvg_NAME_, so that several
# vehicles link into one image. A user of the target needs C99 only: C++17 and Eigen 3.4 stay inside it.
#
#   NAME  as in DIR/lpvguard_vehicle.h (LPVG_VEHICLE)
#   DIR   written by `lpvguard export`: lpvguard_vehicle.h, lpvguard_coeff.c; with a controller also lpvguard_control.c,
#         lpvguard_bus.c and the CAN codec, and then the target has ecu.h, controller.h, can.h, j1939.h and uds.h too
#
# LPVG_DOUBLE, when set, makes lpvg_real_t double; set it before the first vehicle, for the whole image.
# Warnings are errors here; `cmake --compile-no-warning-as-error` lifts that for a compiler that knows new ones.
include_guard(GLOBAL)

set_property(GLOBAL PROPERTY LPVG_CORE_ROOT "${CMAKE_CURRENT_LIST_DIR}")

function(lpvguard_add_vehicle NAME DIR)
  get_property(root GLOBAL PROPERTY LPVG_CORE_ROOT)
  cmake_path(ABSOLUTE_PATH DIR NORMALIZE OUTPUT_VARIABLE folder)
  foreach(file IN ITEMS lpvguard_vehicle.h lpvguard_coeff.c)
    if(NOT EXISTS "${folder}/${file}")
      message(FATAL_ERROR "lpvguard_add_vehicle(${NAME}): ${folder}/${file} is missing; `lpvguard export` writes it")
    endif()
  endforeach()
  # A library whose symbols do not carry its name would collide with another one only at the user's link step.
  file(STRINGS "${folder}/lpvguard_vehicle.h" named REGEX "^#define LPVG_VEHICLE ${NAME}$")
  if(NOT named)
    message(FATAL_ERROR "lpvguard_add_vehicle(${NAME}): ${folder}/lpvguard_vehicle.h is of another vehicle")
  endif()

  find_package(Eigen3 3.4 REQUIRED NO_MODULE)
  get_target_property(eigen Eigen3::Eigen INTERFACE_INCLUDE_DIRECTORIES)

  set(target lpvguard_${NAME})
  add_library(${target} STATIC
    "${root}/src/coeff.cpp" "${root}/src/energy.cpp" "${root}/src/model.cpp" "${root}/src/monitor.cpp" "${folder}/lpvguard_coeff.c")
  add_library(lpvguard::${NAME} ALIAS ${target})
  if(EXISTS "${folder}/lpvguard_control.c")
    target_sources(${target} PRIVATE "${root}/src/controller.cpp" "${folder}/lpvguard_control.c")
  endif()
  if(EXISTS "${folder}/lpvguard_bus.c")
    # can.cpp, authentication.cpp, j1939.cpp, uds.cpp, xcp.cpp and the codec depend on no vehicle: in an image of several vehicles the linker
    # takes the first one's.
    target_sources(${target} PRIVATE "${root}/src/ecu.cpp" "${root}/src/can.cpp" "${root}/src/authentication.cpp"
      "${root}/src/j1939.cpp" "${root}/src/uds.cpp" "${root}/src/xcp.cpp"
      "${folder}/lpvguard_bus.c" "${folder}/lpvg_can_codec.c")
  endif()
  target_include_directories(${target} PUBLIC "${root}/include" "${folder}")
  target_include_directories(${target} SYSTEM PRIVATE ${eigen})
  set_target_properties(${target} PROPERTIES
    C_STANDARD 99 C_EXTENSIONS OFF CXX_STANDARD 17 CXX_STANDARD_REQUIRED ON CXX_EXTENSIONS OFF
    COMPILE_WARNING_AS_ERROR ON)
  # -fno-math-errno: a square root is one instruction and no global state is written.
  target_compile_options(${target} PRIVATE -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow -fno-math-errno
    $<$<COMPILE_LANGUAGE:CXX>:-fno-exceptions;-fno-rtti>)
  # Sizes are fixed, so that Eigen's assertions prove nothing, and would import abort and stdio into an unoptimised build.
  target_compile_definitions(${target} PRIVATE EIGEN_NO_DEBUG)
  if(LPVG_DOUBLE)
    target_compile_definitions(${target} PUBLIC LPVG_DOUBLE)
  endif()
endfunction()
