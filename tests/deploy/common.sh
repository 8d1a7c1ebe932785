#!/usr/bin/env bash
# What the tests of deploy/ share; they source it.
set -euo pipefail

failed=0
fail() {
  printf 'FAILED: %s\n' "$*"
  failed=1
}
skip() {
  printf 'SKIPPED: %s\n' "$*"
  exit 77
}
step() { printf '%(%H:%M:%S)T %s\n' -1 "$*"; }

# until_true SECONDS WHAT COMMAND...: waits until the command succeeds; false, and a word about it, where it never does.
until_true() {
  local seconds=$1 what=$2 deadline=$((SECONDS + $1))
  shift 2
  until "$@" >/dev/null 2>&1; do
    if ((SECONDS >= deadline)); then
      fail "$what: not within $seconds s"
      return 1
    fi
    sleep 0.5
  done
}

# sha_of REPORT.json: the picture's hash.
sha_of() { sed -n 's/.*"pixels_sha256": "\([0-9a-f]*\)".*/\1/p' "$1"; }

# expect_same WHAT EXPECTED FOUND
expect_same() { [[ -n $2 && $2 == "$3" ]] || fail "$1: expected '$2', found '$3'"; }
