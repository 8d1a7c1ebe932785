find_package(nlohmann_json REQUIRED)
gleaner_test(NAME farm_wire SOURCES wire_test.cpp LIBRARIES gleaner_gateway gleaner_packing)
gleaner_test(NAME farm_agent SOURCES agent_test.cpp LIBRARIES gleaner_gateway gleaner_agent nlohmann_json::nlohmann_json)
find_package(PkgConfig REQUIRED)
pkg_check_modules(httplib REQUIRED IMPORTED_TARGET cpp-httplib)
gleaner_test(NAME farm_http SOURCES http_test.cpp LIBRARIES gleaner_http gleaner_gateway PkgConfig::httplib)
gleaner_test(NAME farm_agent_artifacts SOURCES agent_artifacts_test.cpp
             LIBRARIES gleaner_gateway gleaner_agent gleaner_digest nlohmann_json::nlohmann_json)
# Workers as processes, for the test and for bench/artifacts.cpp.
add_executable(block_worker block_worker.cpp)
target_link_libraries(block_worker PRIVATE gleaner_options gleaner_agent gleaner_plan gleaner_digest)
set_target_properties(block_worker PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
gleaner_test(NAME farm_retained_processes SOURCES retained_processes_test.cpp
             LIBRARIES gleaner_gateway gleaner_agent gleaner_digest nlohmann_json::nlohmann_json)
target_compile_definitions(test_farm_retained_processes PRIVATE GLEANER_BLOCK_WORKER="$<TARGET_FILE:block_worker>")
add_dependencies(test_farm_retained_processes block_worker)
find_package(OpenSSL REQUIRED COMPONENTS Crypto) # this folder's own: tests forge tokens
gleaner_test(NAME farm_keys SOURCES keys_test.cpp LIBRARIES gleaner_gateway gleaner_agent PkgConfig::libjwt OpenSSL::Crypto)
gleaner_test(NAME farm_callers SOURCES callers_test.cpp LIBRARIES gleaner_gateway)
gleaner_test(NAME farm_events SOURCES events_test.cpp LIBRARIES gleaner_gateway nlohmann_json::nlohmann_json)
