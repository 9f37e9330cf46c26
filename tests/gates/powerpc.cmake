# A big-endian processor (32-bit PowerPC, emulated by qemu-user) for the preset big-endian. Debian's packages:
# g++-powerpc-linux-gnu, qemu-user.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR powerpc)
set(CMAKE_C_COMPILER powerpc-linux-gnu-gcc)
set(CMAKE_CXX_COMPILER powerpc-linux-gnu-g++)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-ppc)
set(CMAKE_EXE_LINKER_FLAGS_INIT -static)
# Catch2 is a header in this machine's /usr/include, which must come behind the target's own headers, or not at all.
set(CMAKE_CXX_FLAGS_INIT "-idirafter /usr/include")
set(CMAKE_PROJECT_INCLUDE "${CMAKE_CURRENT_LIST_DIR}/powerpc_includes.cmake")
