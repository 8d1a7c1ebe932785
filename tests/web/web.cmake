# What browsers get: the listener under our pages, and the coordinator's page.
find_package(PkgConfig REQUIRED)
pkg_check_modules(httplib REQUIRED IMPORTED_TARGET cpp-httplib)
find_package(nlohmann_json REQUIRED)
gleaner_test(NAME web_server SOURCES web_server_test.cpp LIBRARIES gleaner_web PkgConfig::httplib)
gleaner_test(NAME web_dashboard SOURCES dashboard_test.cpp LIBRARIES gleaner_http gleaner_web PkgConfig::httplib nlohmann_json::nlohmann_json)
# In a real browser: they say so and count as skipped where there is none (exit status 77).
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  find_program(GLEANER_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH REQUIRED)
  add_test(NAME web_dashboard_browser COMMAND ${GLEANER_PYTHON3} -B ${CMAKE_CURRENT_LIST_DIR}/dashboard_browser.py ${CMAKE_RUNTIME_OUTPUT_DIRECTORY})
  set_tests_properties(web_dashboard_browser PROPERTIES LABELS web SKIP_RETURN_CODE 77 TIMEOUT 600)
endif()
