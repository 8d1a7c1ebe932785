find_package(meshoptimizer REQUIRED)
find_library(DRACO_LIBRARY draco REQUIRED)
gleaner_test(NAME import SOURCES import_animation_test.cpp import_compression_test.cpp import_deform_test.cpp import_gltf_bad_test.cpp
                                 import_gltf_test.cpp import_images_test.cpp import_instances_test.cpp import_mesh_test.cpp
                                 import_motion_test.cpp import_obj_test.cpp import_scenes_test.cpp import_sequence_test.cpp
                                 import_tolerance_test.cpp
             LIBRARIES gleaner_test_files gleaner_library meshoptimizer::meshoptimizer ${DRACO_LIBRARY} TOGETHER 7)
gleaner_test(NAME import_fuzz SOURCES import_fuzz_test.cpp LIBRARIES gleaner_test_files)
if(TARGET gleaner_library)
  gleaner_test(NAME import_oracle SOURCES import_oracle_test.cpp LIBRARIES gleaner_test_files gleaner_library)
endif()
