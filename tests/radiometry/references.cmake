if(TARGET gleaner_device AND TARGET gleaner_import AND TARGET gleaner_film)
  gleaner_test(NAME references SOURCES references_test.cpp LIBRARIES gleaner_device gleaner_import gleaner_bvh gleaner_film gleaner_model)
endif()
