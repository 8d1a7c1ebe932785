find_package(CLI11 REQUIRED)
find_package(spdlog REQUIRED)
add_executable(gleaner-coordinator gleaner_coordinator.cpp data_lock.cpp listeners.cpp)
target_link_libraries(gleaner-coordinator PRIVATE gleaner_client gleaner_gateway gleaner_http CLI11::CLI11 spdlog::spdlog)
