# Coordinators that die: the real programs, as processes.
find_package(nlohmann_json REQUIRED)
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  gleaner_test(NAME farm_restart SOURCES restart_test.cpp
               LIBRARIES gleaner_test_files gleaner_proto
               TIMEOUT 900)
  target_compile_definitions(test_farm_restart PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_farm_restart gleaner gleaner-coordinator gleaner-worker)
  get_target_property(journal_definitions gleaner_journal INTERFACE_COMPILE_DEFINITIONS)
  if("GLEANER_POSTGRES" IN_LIST journal_definitions)
    target_compile_definitions(test_farm_restart PRIVATE GLEANER_POSTGRES)
  endif()
  gleaner_test(NAME farm_side_by_side_processes SOURCES side_by_side_processes_test.cpp
               LIBRARIES gleaner_proto nlohmann_json::nlohmann_json TIMEOUT 900)
  target_compile_definitions(test_farm_side_by_side_processes PRIVATE GLEANER_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  add_dependencies(test_farm_side_by_side_processes gleaner gleaner-coordinator gleaner-worker)
endif()
