find_package(CLI11 REQUIRED)
find_package(spdlog REQUIRED)
add_executable(gleaner-worker gleaner_worker.cpp kernel_compiler.cpp)
target_link_libraries(gleaner-worker PRIVATE gleaner_program gleaner_agent CLI11::CLI11 spdlog::spdlog)
