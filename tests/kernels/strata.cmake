if(TARGET gleaner_device AND TARGET gleaner_bvh)
  gleaner_test(NAME kernel_strata SOURCES strata_test.cpp LIBRARIES gleaner_device gleaner_bvh gleaner_model)
endif()
