if(TARGET gleaner AND TARGET gleaner_proto)
  gleaner_test(NAME bad_motion SOURCES bad_motion_test.cpp
               LIBRARIES gleaner_test_files gleaner_proto TIMEOUT 600)
  target_compile_definitions(test_bad_motion PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_bad_motion gleaner)
endif()
