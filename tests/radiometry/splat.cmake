if(TARGET gleaner_device AND TARGET gleaner_library AND TARGET gleaner_plan)
  find_package(nlohmann_json REQUIRED)
  gleaner_test(NAME splat SOURCES splat_test.cpp splat_hessian_test.cpp splat_lobes_test.cpp LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_film gleaner_plan gleaner_model
               nlohmann_json::nlohmann_json)
  gleaner_test(NAME splat_select SOURCES reach_grid_test.cpp splat_coverage_test.cpp splat_judge_test.cpp splat_select_test.cpp splat_smooth_test.cpp LIBRARIES gleaner_device)
endif()
