if(TARGET gleaner_bvh AND TARGET gleaner_library)
  find_package(TBB REQUIRED)
  gleaner_test(NAME bvh SOURCES bvh_test.cpp LIBRARIES gleaner_bvh gleaner_library gleaner_model TBB::tbb)
endif()
