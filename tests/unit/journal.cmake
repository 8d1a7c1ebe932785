find_package(SQLite3 REQUIRED)
gleaner_test(NAME journal SOURCES journal_test.cpp LIBRARIES gleaner_journal gleaner_film SQLite::SQLite3)
