# Workers that say that they live and answer nothing, beside real ones.
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  gleaner_test(NAME farm_mute SOURCES mute_test.cpp LIBRARIES gleaner_gateway gleaner_proto nlohmann_json::nlohmann_json TIMEOUT 600)
  target_compile_definitions(test_farm_mute PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_farm_mute gleaner gleaner-coordinator gleaner-worker)
endif()
