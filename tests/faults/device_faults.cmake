if(TARGET gleaner_device AND TARGET gleaner_bvh AND TARGET gleaner_library)
  gleaner_test(NAME device_faults SOURCES ${CMAKE_CURRENT_LIST_DIR}/device_faults_test.cpp
               LIBRARIES gleaner_device gleaner_bvh gleaner_library ${CMAKE_DL_LIBS})
endif()
