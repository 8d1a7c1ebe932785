gleaner_test(NAME artifacts SOURCES artifact_id_test.cpp LIBRARIES gleaner_artifacts gleaner_blobs)
gleaner_test(NAME blob_store SOURCES blob_store_test.cpp LIBRARIES gleaner_blobs gleaner_film gleaner_plan)
