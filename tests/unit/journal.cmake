find_package(SQLite3 REQUIRED)
gleaner_test(NAME journal SOURCES journal_test.cpp LIBRARIES gleaner_journal gleaner_film SQLite::SQLite3)
get_target_property(journal_definitions gleaner_journal INTERFACE_COMPILE_DEFINITIONS)
if("GLEANER_POSTGRES" IN_LIST journal_definitions)
  find_package(nlohmann_json REQUIRED)
  gleaner_test(NAME postgres_journal SOURCES postgres_journal_test.cpp
               LIBRARIES gleaner_journal gleaner_film gleaner_proto nlohmann_json::nlohmann_json)
endif()
