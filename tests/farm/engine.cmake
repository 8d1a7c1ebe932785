find_package(nlohmann_json REQUIRED)
gleaner_test(NAME farm_jobs SOURCES engine_test.cpp jobs_test.cpp journal_test.cpp overview_test.cpp recheck_test.cpp retained_test.cpp
                                    side_by_side_test.cpp
             LIBRARIES gleaner_jobs nlohmann_json::nlohmann_json TOGETHER 4)
