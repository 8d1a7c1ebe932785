gleaner_test(NAME packing SOURCES packing_test.cpp LIBRARIES gleaner_packing)
