#!/usr/bin/env bash
# Every C++ and OpenCL source has the format of .clang-format. Usage: format.sh CLANG_FORMAT, in the project's root.
set -euo pipefail
mapfile -d '' -t sources < <(find scene kernels worker coordinator cli bench tests -type f \
  \( -name '*.cpp' -o -name '*.h' -o -name '*.cl' \) -print0)
((${#sources[@]} > 20)) || { echo "expected the project's sources in $PWD, found ${#sources[@]}"; exit 1; }
printf '%s\0' "${sources[@]}" | xargs -0 -n 25 -P 2 "$1" --dry-run -Werror --style=file
