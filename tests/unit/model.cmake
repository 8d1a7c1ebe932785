gleaner_test(NAME model SOURCES model_test.cpp LIBRARIES gleaner_model)
gleaner_test(NAME model_blob SOURCES model_blob_test.cpp LIBRARIES gleaner_model)
