if(TARGET gleaner_device AND TARGET gleaner_library AND TARGET gleaner_plan)
  find_package(nlohmann_json REQUIRED)
  gleaner_test(NAME photon SOURCES photon_test.cpp photon_lobes_test.cpp LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_film gleaner_plan gleaner_model
               nlohmann_json::nlohmann_json)
  gleaner_test(NAME photon_guide SOURCES photon_guide_test.cpp LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_film gleaner_plan
               gleaner_model nlohmann_json::nlohmann_json)
endif()
