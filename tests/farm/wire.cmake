find_package(nlohmann_json REQUIRED)
gleaner_test(NAME farm_wire SOURCES wire_test.cpp LIBRARIES gleaner_gateway)
gleaner_test(NAME farm_agent SOURCES agent_test.cpp LIBRARIES gleaner_gateway gleaner_agent nlohmann_json::nlohmann_json)
