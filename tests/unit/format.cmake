# Sources have one format, and scripts do what they promise.
find_program(GLEANER_CLANG_FORMAT clang-format REQUIRED)
add_test(NAME format COMMAND ${CMAKE_CURRENT_LIST_DIR}/format.sh ${GLEANER_CLANG_FORMAT})
add_test(NAME scripts COMMAND ${CMAKE_CURRENT_LIST_DIR}/scripts.sh)
add_test(NAME farm_script COMMAND ${CMAKE_CURRENT_LIST_DIR}/farm_script.sh ${CMAKE_SOURCE_DIR})
set_tests_properties(format scripts farm_script PROPERTIES LABELS unit TIMEOUT 120 WORKING_DIRECTORY ${CMAKE_SOURCE_DIR})
