#!/usr/bin/env bash
# Every shell script parses, stops at the first error, and may be run. In the project's root.
set -euo pipefail
mapfile -t scripts < <(find farm .ci bench deploy tests -type f -exec grep -lE '^#!.*\b(ba)?sh$' {} +)
((${#scripts[@]} >= 4)) || { echo "expected the project's scripts in $PWD, found ${#scripts[@]}"; exit 1; }
failed=0
for script in "${scripts[@]}"; do
  bash -n "$script" || failed=1
  grep -q '^set -euo pipefail$' "$script" || { echo "$script: expected a line 'set -euo pipefail'"; failed=1; }
  [[ -x $script ]] || { echo "$script: expected to be executable"; failed=1; }
done
exit "$failed"
