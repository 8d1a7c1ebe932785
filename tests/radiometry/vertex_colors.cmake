if(TARGET gleaner_device AND TARGET gleaner_library AND TARGET gleaner_film)
  gleaner_test(NAME vertex_colors SOURCES vertex_colors_test.cpp
               LIBRARIES gleaner_device gleaner_library gleaner_bvh gleaner_film gleaner_model)
endif()
