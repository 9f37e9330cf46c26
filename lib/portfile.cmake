# The core as a port of vcpkg: sources, headers and the function that builds a vehicle from them. Nothing is compiled here.
set(VCPKG_POLICY_EMPTY_PACKAGE enabled)  # neither include/ nor lib/: a library is built for each vehicle, in the user's own build
foreach(folder IN ITEMS include src vehicles)
  file(INSTALL "${CMAKE_CURRENT_LIST_DIR}/${folder}" DESTINATION "${CURRENT_PACKAGES_DIR}/share/${PORT}")
endforeach()
file(INSTALL "${CMAKE_CURRENT_LIST_DIR}/lpvguardConfig.cmake" "${CMAKE_CURRENT_LIST_DIR}/lpvguardAddVehicle.cmake"
  DESTINATION "${CURRENT_PACKAGES_DIR}/share/${PORT}")
vcpkg_install_copyright(FILE_LIST "${CMAKE_CURRENT_LIST_DIR}/../LICENSE")
