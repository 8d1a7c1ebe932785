find_package(OpenImageIO REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(meshoptimizer REQUIRED)
find_library(DRACO_LIBRARY draco REQUIRED)
foreach(subject gltf gltf_bad animation motion sequence deform instances compression tolerance mesh obj images scenes fuzz)
  gleaner_test(NAME import_${subject} SOURCES import_${subject}_test.cpp import_files.cpp
               LIBRARIES gleaner_import OpenImageIO::OpenImageIO nlohmann_json::nlohmann_json)
endforeach()
target_link_libraries(test_import_compression PRIVATE meshoptimizer::meshoptimizer ${DRACO_LIBRARY})
target_link_libraries(test_import_instances PRIVATE gleaner_library)
if(TARGET gleaner_library)
  gleaner_test(NAME import_oracle SOURCES import_oracle_test.cpp import_files.cpp
               LIBRARIES gleaner_import gleaner_library OpenImageIO::OpenImageIO nlohmann_json::nlohmann_json)
endif()
