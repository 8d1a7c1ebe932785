# Writes OUTPUT: a C++ file with the SHA-256 over FILES (their paths below ROOT, and their bytes).
set(all "")
list(SORT FILES)
foreach(file ${FILES})
  file(RELATIVE_PATH name ${ROOT} ${file})
  file(SHA256 ${file} digest)
  string(APPEND all "${digest} ${name}\n")
endforeach()
string(SHA256 build "${all}")
file(WRITE ${OUTPUT} "#include \"gleaner/kernels_build.h\"\n\nnamespace gleaner {\n\n"
                     "const char* kernels_build() { return \"${build}\"; }\n\n}  // namespace gleaner\n")
