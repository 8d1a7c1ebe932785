# What the system allows a coordinator: descriptors, sizes of files.
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  gleaner_test(NAME farm_limits SOURCES limits_test.cpp LIBRARIES gleaner_model gleaner_proto nlohmann_json::nlohmann_json TIMEOUT 300)
  target_compile_definitions(test_farm_limits PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_farm_limits gleaner gleaner-coordinator gleaner-worker)
endif()
