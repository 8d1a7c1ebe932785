if(TARGET gleaner_device AND TARGET gleaner_library AND TARGET gleaner_plan)
  find_package(nlohmann_json REQUIRED)
  gleaner_test(NAME denoise_frames SOURCES denoise_test.cpp LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_film gleaner_plan gleaner_model
               nlohmann_json::nlohmann_json)
  target_compile_definitions(test_denoise_frames PRIVATE GLEANER_BUILT_OIDN="${CMAKE_BINARY_DIR}/oidn")
endif()
