# Writes OUTPUT: a C++ file in which FUNCTION (NAMESPACE::TYPE's, of the header INCLUDE) returns a table of (path below ROOT, text) of
# FILES.
set(text "#include \"${INCLUDE}\"\n\nnamespace ${NAMESPACE} {\n\n")
string(APPEND text "const std::vector<${TYPE}>& ${FUNCTION}() {\n  static const std::vector<${TYPE}> sources = {\n")
foreach(file ${FILES})
  file(RELATIVE_PATH name ${ROOT} ${file})
  file(READ ${file} body)
  string(APPEND text "      {\"${name}\", R\"GLEANER(${body})GLEANER\"},\n")
endforeach()
string(APPEND text "  };\n  return sources;\n}\n\n}  // namespace ${NAMESPACE}\n")
file(WRITE ${OUTPUT} "${text}")
