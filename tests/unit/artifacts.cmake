gleaner_test(NAME artifacts SOURCES artifact_id_test.cpp artifact_registry_test.cpp artifact_relay_test.cpp
             LIBRARIES gleaner_artifacts gleaner_blobs gleaner_film gleaner_schedule)
gleaner_test(NAME blob_store SOURCES blob_store_test.cpp LIBRARIES gleaner_blobs gleaner_film)
gleaner_test(NAME part_store SOURCES part_store_test.cpp LIBRARIES gleaner_parts gleaner_film gleaner_blobs)
