# Optional parts of the tests (tools/setup.sh installs them): what is missing is a skipped test with its reason, never an absent one.

# lpvg_missing(RESULT PART PROGRAM...): RESULT is why PART cannot be used here; empty: it can.
function(lpvg_missing result part)
  set(why "")
  if(" $ENV{LPVGUARD_WITHOUT} " MATCHES " ${part} ")
    set(why "LPVGUARD_WITHOUT names ${part}")
  else()
    foreach(program IN LISTS ARGN)
      find_program(found ${program} NO_CACHE)
      if(NOT found)
        string(APPEND why "${program} not found; ")
      endif()
      unset(found)
    endforeach()
    string(REGEX REPLACE "; $" "" why "${why}")
  endif()
  set(${result} "${why}" PARENT_SCOPE)
endfunction()

# lpvg_skipped_test(NAME LABEL WHY): stands for a test that cannot be built or run here.
function(lpvg_skipped_test NAME LABEL WHY)
  add_test(NAME ${NAME} COMMAND ${CMAKE_COMMAND} -E echo "skipped: ${WHY}")
  set_tests_properties(${NAME} PROPERTIES LABELS "${LABEL}" SKIP_REGULAR_EXPRESSION "^skipped: ")
endfunction()
