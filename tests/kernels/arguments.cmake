if(TARGET gleaner_device AND TARGET gleaner_library)
  gleaner_test(NAME kernel_arguments SOURCES arguments_test.cpp LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_model)
endif()
