find_package(OpenImageIO REQUIRED)
find_package(nlohmann_json REQUIRED)
foreach(subject gltf gltf_bad obj images scenes fuzz)
  gleaner_test(NAME import_${subject} SOURCES import_${subject}_test.cpp import_files.cpp
               LIBRARIES gleaner_import OpenImageIO::OpenImageIO nlohmann_json::nlohmann_json)
endforeach()
