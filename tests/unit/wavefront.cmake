if(TARGET gleaner_device)
  gleaner_test(NAME wavefront SOURCES wavefront_test.cpp LIBRARIES gleaner_device gleaner_model)
endif()
