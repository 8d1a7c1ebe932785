if(TARGET gleaner_device AND TARGET gleaner_library AND TARGET gleaner_plan)
  gleaner_test(NAME ao SOURCES ao_test.cpp LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_film gleaner_plan gleaner_model)
endif()
