find_package(nlohmann_json REQUIRED)
find_package(PkgConfig REQUIRED)
pkg_check_modules(httplib REQUIRED IMPORTED_TARGET cpp-httplib)
find_package(OpenSSL REQUIRED COMPONENTS Crypto) # this folder's own: tests forge tokens
gleaner_test(NAME farm_http SOURCES http_test.cpp LIBRARIES gleaner_http gleaner_gateway PkgConfig::httplib)
gleaner_test(NAME farm_wire SOURCES agent_test.cpp agent_artifacts_test.cpp callers_test.cpp events_test.cpp keys_test.cpp
                                    retained_processes_test.cpp wire_test.cpp
             LIBRARIES gleaner_gateway gleaner_agent gleaner_packing gleaner_digest nlohmann_json::nlohmann_json PkgConfig::libjwt OpenSSL::Crypto
             TOGETHER 4)
# Workers as processes, for the test and for bench/artifacts.cpp.
add_executable(block_worker block_worker.cpp)
target_link_libraries(block_worker PRIVATE gleaner_options gleaner_agent gleaner_plan gleaner_digest)
set_target_properties(block_worker PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
target_compile_definitions(test_farm_wire PRIVATE GLEANER_BLOCK_WORKER="$<TARGET_FILE:block_worker>")
add_dependencies(test_farm_wire block_worker)
