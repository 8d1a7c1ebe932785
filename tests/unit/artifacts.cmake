gleaner_test(NAME artifacts SOURCES artifact_id_test.cpp LIBRARIES gleaner_artifacts)
