# gleaner_embed(OUTPUT file.cpp INCLUDE header NAMESPACE ns TYPE type FUNCTION name ROOT folder FILES ...): text files inside the
# program. See EmbedSources.cmake, which writes OUTPUT when one of them has changed.
function(gleaner_embed)
  cmake_parse_arguments(E "" "OUTPUT;INCLUDE;NAMESPACE;TYPE;FUNCTION;ROOT" "FILES" ${ARGN})
  add_custom_command(
    OUTPUT ${E_OUTPUT}
    COMMAND ${CMAKE_COMMAND} -DOUTPUT=${E_OUTPUT} -DINCLUDE=${E_INCLUDE} -DNAMESPACE=${E_NAMESPACE} -DTYPE=${E_TYPE}
            -DFUNCTION=${E_FUNCTION} -DROOT=${E_ROOT} "-DFILES=${E_FILES}" -P ${CMAKE_SOURCE_DIR}/cmake/EmbedSources.cmake
    DEPENDS ${E_FILES} ${CMAKE_SOURCE_DIR}/cmake/EmbedSources.cmake
    VERBATIM)
endfunction()
