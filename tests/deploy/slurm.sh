#!/usr/bin/env bash
# Workers as a Slurm array, while a frame is rendered: told to go, at the end of their time, preempted; the picture has the same
# bits, and what Slurm queued anew works again. Needs a Slurm cluster that shares this file system. Usage: slurm.sh PROJECT_ROOT
# PROGRAMS_DIR
set -euo pipefail
source "$(dirname "$0")/common.sh"
root=$1 programs=$2
command -v sbatch >/dev/null || skip "no Slurm here"
timeout 20 sinfo >/dev/null 2>&1 || skip "no Slurm controller answers (SLURM_CONF=${SLURM_CONF:-})"

place=$(mktemp -d)
array= pid=
finish() {
  [[ -z $array ]] || scancel --name="gleaner-test-$$" 2>/dev/null || true
  [[ -z $pid ]] || kill -TERM "$pid" 2>/dev/null || true
  [[ -z $pid ]] || wait "$pid" 2>/dev/null || true
  rm -rf "$place"
}
trap finish EXIT

gleaner() { "$programs/gleaner" "$@"; }
connected() { gleaner workers | grep -c "^slurm-${array}_$1 "; }
is_connected() { (($(connected "$1") == 1)); }
is_gone() { (($(connected "$1") == 0)); }
restarts() { scontrol show job "${array}_$1" | sed -n 's/.*Restarts=\([0-9]*\).*/\1/p'; }
has_restarted() { (($(restarts "$1") == 1)); }
has_begun() { gleaner show "$1" --json | grep '"items_done":[1-9]' >/dev/null; }
submit_workers() { # submit_workers OPTIONS...: the array's number
  sbatch --parsable --job-name="gleaner-test-$$" --cpus-per-task=1 --mem=400M --time=30 --output="$place/%a.log" \
    --export="ALL,GLEANER_BIN=$programs" "$@" "$root/deploy/slurm/workers.sbatch"
}

"$programs/gleaner-coordinator" --listen 127.0.0.1:0 --data "$place/data" >"$place/address" 2>"$place/coordinator.log" &
pid=$!
until_true 30 "the coordinator listens" test -s "$place/address" || exit 1
GLEANER_COORDINATOR=$(cat "$place/address")
export GLEANER_COORDINATOR

step "an array of four workers"
array=$(submit_workers --array=1-4)
for task in 1 2 3 4; do until_true 120 "task $task is connected" is_connected "$task" || exit 1; done

gleaner scene cornell-box -o "$place/box.glb" 2>/dev/null
frame=("$place/box.glb" --size 256x256 --spp 512 --seed 7)
job=$(gleaner submit "${frame[@]}")
until_true 120 "the frame begins" has_begun "$job" || true

step "task 1 is told to go"
scancel --batch --signal=TERM "${array}_1"
until_true 60 "task 1 is gone" is_gone 1 || true
grep -q 'leaving when the batch that runs is done' "$place/1.log" || fail "task 1 did not drain: $(tail -n 3 "$place/1.log")"
until_true 30 "task 1 has ended" eval "! squeue -h -j ${array}_1 2>/dev/null | grep . >/dev/null" || true

step "task 2 comes to the end of its time"
# As Slurm does before the limit; that Slurm does it at that time is Slurm's own affair.
scancel --batch --signal=USR1 "${array}_2"
until_true 60 "task 2 is gone" is_gone 2 || true
until_true 30 "task 2 is queued anew" has_restarted 2 || true
grep -q 'is queued anew' "$place/2.log" || fail "task 2 does not say so"

if scontrol show config | grep 'PreemptMode *= REQUEUE' >/dev/null && sinfo -h -o %P | grep '^urgent' >/dev/null; then
  step "urgent jobs take all nodes"
  nodes=$(sinfo -h -p urgent -o %D)
  sbatch --job-name="gleaner-test-$$" -p urgent -N "$nodes" -n "$nodes" --exclusive --mem=1000M --time=1 --output=/dev/null \
    --wrap "sleep 15" >/dev/null
  for task in 3 4; do
    until_true 60 "task $task is preempted" is_gone "$task" || true
    until_true 30 "task $task is queued anew" has_restarted "$task" || true
    grep -q 'leaving when the batch that runs is done' "$place/$task.log" || fail "task $task did not drain"
  done
else
  echo "this cluster has no partition 'urgent' that preempts by requeueing: preemption was not tried"
fi

step "what was queued anew works again (Slurm waits two minutes)"
for task in 2 3 4; do until_true 240 "task $task is back" is_connected "$task" || true; done
gleaner watch "$job" >"$place/watch" 2>&1 || fail "watch: $(tail -n 1 "$place/watch")"
gleaner fetch "$job" -o "$place/pictures" >/dev/null
gleaner render "${frame[@]}" -o "$place/alone.exr" --report "$place/alone.json" --quiet
expect_same "the picture" "$(sha_of "$place/alone.json")" "$(sha_of "$place/pictures/frame_0001.json")"
exit "$failed"
