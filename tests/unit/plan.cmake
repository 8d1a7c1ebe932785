if(TARGET gleaner_plan AND TARGET gleaner_library)
  gleaner_test(NAME plan SOURCES graph_test.cpp methods_test.cpp plan_test.cpp vpl_pilot_test.cpp way_points_test.cpp
               LIBRARIES gleaner_plan gleaner_artifacts gleaner_library gleaner_model)
endif()
