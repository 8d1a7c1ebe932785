add_library(schedule_simulation STATIC ${CMAKE_CURRENT_LIST_DIR}/schedule_simulation.cpp)
target_link_libraries(schedule_simulation PUBLIC gleaner_schedule)
gleaner_test(NAME schedule_balance SOURCES ${CMAKE_CURRENT_LIST_DIR}/schedule_balance_test.cpp LIBRARIES schedule_simulation)
gleaner_test(NAME schedule_farm SOURCES ${CMAKE_CURRENT_LIST_DIR}/schedule_farm_test.cpp LIBRARIES schedule_simulation)
