find_program(GLEANER_CLANG_FORMAT clang-format REQUIRED)
add_test(NAME format COMMAND ${CMAKE_CURRENT_LIST_DIR}/format.sh ${GLEANER_CLANG_FORMAT})
add_test(NAME scripts COMMAND ${CMAKE_CURRENT_LIST_DIR}/scripts.sh)
set_tests_properties(format scripts PROPERTIES LABELS unit TIMEOUT 120 WORKING_DIRECTORY ${CMAKE_SOURCE_DIR})
