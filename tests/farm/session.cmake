# The embedded farm of `gleaner session`, with its devices.
if(TARGET gleaner)
  gleaner_test(NAME farm_session SOURCES session_test.cpp LIBRARIES gleaner_embedded gleaner_library gleaner_bvh)
endif()
