if(TARGET gleaner_device)
  gleaner_test(NAME compilers SOURCES compilers_test.cpp LIBRARIES gleaner_device gleaner_model)
endif()
