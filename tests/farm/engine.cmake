find_package(nlohmann_json REQUIRED)
gleaner_test(NAME farm_engine SOURCES engine_test.cpp LIBRARIES gleaner_jobs nlohmann_json::nlohmann_json)
gleaner_test(NAME farm_jobs SOURCES jobs_test.cpp LIBRARIES gleaner_jobs nlohmann_json::nlohmann_json)
gleaner_test(NAME farm_retained SOURCES retained_test.cpp LIBRARIES gleaner_jobs nlohmann_json::nlohmann_json)
