# The embedded farm of `gleaner render`, with its devices.
find_package(nlohmann_json REQUIRED)
if(TARGET gleaner)
  gleaner_test(NAME farm_trajectory SOURCES trajectory_test.cpp LIBRARIES gleaner_embedded gleaner_library gleaner_bvh nlohmann_json::nlohmann_json)
endif()
