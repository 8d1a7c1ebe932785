# The embedded farm of `gleaner session`, with its devices.
if(TARGET gleaner)
  gleaner_test(NAME farm_session SOURCES session_test.cpp ${CMAKE_SOURCE_DIR}/cli/embedded.cpp
               LIBRARIES gleaner_program gleaner_gateway gleaner_agent gleaner_library gleaner_bvh)
endif()
