gleaner_test(NAME schedule SOURCES ${CMAKE_CURRENT_LIST_DIR}/schedule_test.cpp LIBRARIES gleaner_schedule)
gleaner_test(NAME schedule_fuzz SOURCES ${CMAKE_CURRENT_LIST_DIR}/schedule_fuzz_test.cpp LIBRARIES gleaner_schedule)
gleaner_test(NAME schedule_inputs SOURCES ${CMAKE_CURRENT_LIST_DIR}/schedule_inputs_test.cpp LIBRARIES gleaner_schedule)
