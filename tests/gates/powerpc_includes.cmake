# Read by project(), after the compilers are known: keeps /usr/include from being given with -isystem (powerpc.cmake).
list(APPEND CMAKE_C_IMPLICIT_INCLUDE_DIRECTORIES /usr/include)
list(APPEND CMAKE_CXX_IMPLICIT_INCLUDE_DIRECTORIES /usr/include)
