#!/usr/bin/env bash
# systemd finds no fault with the units, and what they may do stays small. Usage: systemd.sh PROJECT_ROOT PROGRAMS_DIR
set -euo pipefail
source "$(dirname "$0")/common.sh"
command -v systemd-analyze >/dev/null || skip "no systemd-analyze here"
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT

cp "$1"/deploy/systemd/*.service "$place"
# Programs are looked for where the units say; here they lie in the build folder.
sed -i "s|/usr/local/bin/|$2/|" "$place"/*.service
cp "$place/gleaner-worker@.service" "$place/gleaner-worker@1.service"
for unit in gleaner-coordinator.service gleaner-worker@1.service; do
  words=$(systemd-analyze verify --man=no --recursive-errors=no "$place/$unit" 2>&1) || fail "$unit: verify: $words"
  [[ -z $words ]] || fail "$unit: verify says: $words"
  # From 0 (nothing is allowed) to 100; a unit without any of the limits has 96.
  systemd-analyze security --offline=yes --threshold=35 "$place/$unit" >"$place/security" 2>&1 ||
    fail "$unit: exposed more than expected: $(tail -n 1 "$place/security")"
  tail -n 1 "$place/security"
done
exit "$failed"
