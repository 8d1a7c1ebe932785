# Workers that say that they live and answer nothing, beside real ones.
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  gleaner_test(NAME farm_mute SOURCES mute_test.cpp LIBRARIES gleaner_gateway gleaner_proto nlohmann_json::nlohmann_json TIMEOUT 600)
  target_compile_definitions(test_farm_mute PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_farm_mute gleaner gleaner-coordinator gleaner-worker)
  add_executable(lying_worker lying_worker.cpp)
  target_link_libraries(lying_worker PRIVATE gleaner_options gleaner_agent)
  set_target_properties(lying_worker PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
  gleaner_test(NAME farm_siege SOURCES siege_test.cpp LIBRARIES gleaner_gateway gleaner_proto nlohmann_json::nlohmann_json TIMEOUT 900)
  target_compile_definitions(test_farm_siege PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}"
                                                     GLEANER_LYING_WORKER="$<TARGET_FILE:lying_worker>")
  add_dependencies(test_farm_siege gleaner gleaner-coordinator gleaner-worker lying_worker)
endif()
