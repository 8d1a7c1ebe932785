find_package(CLI11 REQUIRED)
find_package(spdlog REQUIRED)
add_executable(gleaner-coordinator gleaner_coordinator.cpp client.cpp data_lock.cpp listeners.cpp machine_memory.cpp program.cpp signals.cpp)
target_link_libraries(gleaner-coordinator PRIVATE gleaner_gateway gleaner_http CLI11::CLI11 spdlog::spdlog)
