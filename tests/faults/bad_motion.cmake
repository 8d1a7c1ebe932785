find_package(OpenImageIO REQUIRED)
find_package(nlohmann_json REQUIRED)
if(TARGET gleaner AND TARGET gleaner_proto)
  gleaner_test(NAME bad_motion SOURCES bad_motion_test.cpp ../unit/import_files.cpp
               LIBRARIES gleaner_import gleaner_proto OpenImageIO::OpenImageIO nlohmann_json::nlohmann_json TIMEOUT 600)
  target_compile_definitions(test_bad_motion PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_bad_motion gleaner)
endif()
