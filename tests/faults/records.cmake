if(TARGET gleaner_device AND TARGET gleaner_bvh AND TARGET gleaner_library AND TARGET gleaner_plan)
  find_package(nlohmann_json REQUIRED)
  gleaner_test(NAME records SOURCES records_test.cpp LIBRARIES gleaner_device gleaner_bvh gleaner_library gleaner_plan
               gleaner_model nlohmann_json::nlohmann_json)
endif()
