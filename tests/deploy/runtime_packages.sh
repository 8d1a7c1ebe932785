#!/usr/bin/env bash
# deploy/packages-runtime-debian12.txt is what the programs are linked with, no more and no less: else the image does not start,
# or carries what nobody needs. Usage: runtime_packages.sh PROJECT_ROOT PROGRAMS_DIR
set -euo pipefail
source "$(dirname "$0")/common.sh"
command -v dpkg-query >/dev/null || skip "no dpkg here to say which package a library belongs to"

# The packages of the libraries that a program names itself; their own dependencies follow.
linked() {
  local program library path
  for program in gleaner gleaner-coordinator gleaner-worker ../lib/gleaner-images.so; do
    readelf -d "$1/$program" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p'
  done | sort -u | while read -r library; do
    path=$(ldconfig -p | awk -v name="$library" '$1 == name { print $NF; exit }')
    path=$(readlink -f "$path")
    # Where /lib is a link to /usr/lib, packages may still list the old place.
    { dpkg-query --search "$path" "${path#/usr}" 2>/dev/null || true; } | cut -d : -f 1
  done | sort -u | grep -vxE 'libc6|libgcc-s1' # in every image
}

found=$(linked "$2")
listed=$(sed 's/#.*//; s/[[:space:]]*$//; /^$/d' "$1/deploy/packages-runtime-debian12.txt" | sort -u)
difference=$(diff <(printf '%s\n' "$listed") <(printf '%s\n' "$found")) ||
  fail "packages-runtime-debian12.txt (<) and what the programs are linked with (>) differ:"$'\n'"$difference"
exit "$failed"
