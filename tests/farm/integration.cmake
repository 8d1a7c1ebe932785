# The real programs, as processes: they are built before the test runs.
find_package(nlohmann_json REQUIRED)
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  gleaner_test(NAME farm_integration SOURCES integration_test.cpp LIBRARIES gleaner_model gleaner_proto nlohmann_json::nlohmann_json TIMEOUT 900)
  target_compile_definitions(test_farm_integration PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_farm_integration gleaner gleaner-coordinator gleaner-worker)
endif()
