if(TARGET gleaner_plan AND TARGET gleaner_library AND TARGET gleaner_device)
  gleaner_test(NAME plan SOURCES graph_test.cpp limited_plan_test.cpp links_choice_test.cpp methods_test.cpp plan_facts_test.cpp photon_choice_test.cpp plan_test.cpp splat_choice_test.cpp cache_noise_test.cpp vpl_pilot_test.cpp trajectory_test.cpp vpl_host_stages_test.cpp
               LIBRARIES gleaner_plan gleaner_artifacts gleaner_device gleaner_library gleaner_model TOGETHER 6)
endif()
