if(TARGET gleaner_device)
  gleaner_test(NAME wavefront SOURCES wanted_test.cpp wavefront_test.cpp LIBRARIES gleaner_device gleaner_model)
endif()
