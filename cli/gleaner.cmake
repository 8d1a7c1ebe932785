# `gleaner`: all of cli/*.cpp but the other programs' mains and what is a library. The commands are those whose files are there.
find_package(nlohmann_json REQUIRED)
find_package(CLI11 REQUIRED)
find_package(fmt REQUIRED)

file(GLOB gleaner_sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/*.cpp)
list(FILTER gleaner_sources EXCLUDE REGEX "/(gleaner_(coordinator|worker)|data_lock|client|embedded|machine_memory|program|signals)\\.cpp$")

set(gleaner_commands "")
foreach(command render session submit watch events fetch show list cancel pause resume retry workers drain why replay explain methods info compare denoise scene devices keys)
  if(EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/${command}.cpp)
    string(APPEND gleaner_commands " X(${command})")
  endif()
endforeach()
file(CONFIGURE OUTPUT ${CMAKE_BINARY_DIR}/generated/cli/present_commands.h
     CONTENT "#define GLEANER_COMMANDS(X)@gleaner_commands@\n" @ONLY)

add_executable(gleaner ${gleaner_sources})
target_link_libraries(gleaner PRIVATE gleaner_client gleaner_embedded gleaner_gateway gleaner_status_json gleaner_agent gleaner_import gleaner_bvh gleaner_library gleaner_viewer CLI11::CLI11 fmt::fmt
                                      nlohmann_json::nlohmann_json)

# Commands are compiled some at a time: each file that reads CLI11 compiles the validators that it defines, which takes
# five seconds.
gleaner_compile_together(gleaner 10)
target_compile_options(gleaner PRIVATE $<$<CONFIG:Release>:-O1>)  # the work is done in libraries
