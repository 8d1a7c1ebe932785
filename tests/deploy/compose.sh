#!/usr/bin/env bash
# A farm of containers, started as people start it, through a bad night: a worker stands still for more than two leases, one is
# killed, one loses its network for a while; the picture has the same bits. Then health checks, restarts, limits, graceful ends.
# Needs root and a Docker engine; takes some ten minutes. Usage: compose.sh PROJECT_ROOT PROGRAMS_DIR
# $GLEANER_BUILD_NETWORK=host where containers reach no network of their own while the image is built.
set -euo pipefail
source "$(dirname "$0")/common.sh"
root=$1 programs=$2
command -v docker >/dev/null || skip "no docker here"
timeout 20 docker version >/dev/null 2>&1 || skip "no Docker engine answers (DOCKER_HOST=${DOCKER_HOST:-})"
docker compose version >/dev/null 2>&1 || command -v docker-compose >/dev/null || skip "no docker compose here"
((EUID == 0)) || skip "processes of containers are killed from outside, which needs root"

export GLEANER_PROJECT=gleaner-test-$$ GLEANER_LISTEN=127.0.0.1:18780 GLEANER_HTTP=127.0.0.1:18781
export GLEANER_COORDINATOR=$GLEANER_LISTEN
image=${GLEANER_IMAGE:-gleaner:latest}
place=$(mktemp -d)
containers() { docker ps -aq --filter "label=com.docker.compose.project=$GLEANER_PROJECT" "$@"; }
finish() {
  local id
  for id in $(containers); do docker unpause "$id" >/dev/null 2>&1 || true; done
  "$root/farm" down >/dev/null 2>&1 || true
  docker volume rm "${GLEANER_PROJECT}_data" "${GLEANER_PROJECT}_kernels" >/dev/null 2>&1 || true
  rm -rf "$place"
}
trap finish EXIT

gleaner() { "$programs/gleaner" "$@"; }
inspect() { docker inspect --format "$2" "$1"; }
service() { containers --filter "label=com.docker.compose.service=$1"; }
connected() { gleaner workers | wc -l; }
has_workers() { (($(connected) == $1)); }
state_of() { gleaner show "$1" --json | grep -o '"state":"[a-z]*"' | cut -d '"' -f 4; }
running() { [[ $(state_of "$1") == running ]]; }
items_done() { gleaner show "$1" --json | grep -o '"items_done":[0-9]*' | awk -F : '{ n += $2 } END { print n + 0 }'; }
has_begun() { (($(items_done "$1") > 0)); }
health_is() { [[ $(inspect "$coordinator" '{{.State.Health.Status}}') == "$1" ]]; }
main_pid() { inspect "$1" '{{.State.Pid}}'; }
logged() { [[ $(docker logs "$1" 2>&1) == *"$2"* ]]; }
frame() { printf '%s ' "$place/box.glb" --size 256x256 --spp "$1" --seed 7; }
# The same frame in one process inside one container.
alone() { # alone SPP
  # Compiled kernels are loaded as libraries, which Docker's usual tmpfs forbids.
  docker run --rm --network none --user "$(id -u):$(id -g)" --tmpfs /cache:exec -v "$place:$place" "$image" \
    gleaner render $(frame "$1") -o "$place/alone.exr" --report "$place/alone.json" --quiet
  sha_of "$place/alone.json"
}
rendered() { # rendered JOB: waits for it; the hash of its picture
  gleaner watch "$1" >"$place/watch.log" 2>&1 || fail "watch: $(tail -n 3 "$place/watch.log")"
  gleaner fetch "$1" -o "$place/$1" >/dev/null 2>&1 || fail "fetch $1"
  sha_of "$place/$1/frame_0001.json"
}

step "building the image, starting three workers"
"$root/farm" up --docker 3 || {
  cat "$root"/.farm/image.log "$root"/.farm/compose.log 2>/dev/null | tail -n 40
  fail "farm up --docker 3"
  exit 1
}
has_workers 3 || fail "expected 3 workers, found $(connected)"
coordinator=$(service coordinator)
mapfile -t workers < <(service worker)
health_is healthy || fail "the coordinator's container is $(inspect "$coordinator" '{{.State.Health.Status}}')"

step "what the containers may do"
for id in "$coordinator" "${workers[@]}"; do
  expect_same "read-only root" true "$(inspect "$id" '{{.HostConfig.ReadonlyRootfs}}')"
  expect_same "user" 10001 "$(docker exec "$id" id -u)"
  expect_same "capabilities" 0000000000000000 "$(docker exec "$id" sed -n 's/^CapEff:\t//p' /proc/1/status)"
  expect_same "restart policy" unless-stopped "$(inspect "$id" '{{.HostConfig.RestartPolicy.Name}}')"
  ! docker exec "$id" touch /usr/local/x 2>/dev/null || fail "$id: its root can be written to"
  for limit in Memory PidsLimit NanoCpus; do
    (($(inspect "$id" "{{.HostConfig.$limit}}") > 0)) || fail "$id: no limit of $limit"
  done
done
if docker port "$coordinator" | grep -v ' -> 127\.0\.0\.1:'; then fail "a port is open to other machines"; fi
bytes=$(($(inspect "$image" '{{.Size}}') - $(inspect "${GLEANER_BASE:-debian:bookworm}" '{{.Size}}')))
step "the image is $((bytes / 1000000)) MB over its base"
((bytes <= 900000000)) || fail "image: expected at most 900 MB over the base"

step "metrics"
/usr/bin/python3 - "http://$GLEANER_HTTP" "$place/metrics" <<'PY'
import sys, urllib.request
assert urllib.request.urlopen(sys.argv[1] + "/healthz", timeout=10).read() == b"ok\n"
open(sys.argv[2], "wb").write(urllib.request.urlopen(sys.argv[1] + "/metrics", timeout=10).read())
PY
grep -q '^gleaner_workers{state="serving"} 3$' "$place/metrics" || fail "metrics: expected 3 workers"
if command -v promtool >/dev/null; then
  promtool check metrics <"$place/metrics" || fail "promtool finds fault with /metrics"
else
  echo "no promtool here: the page's format was not checked by Prometheus itself"
fi

step "a coordinator that hangs is unhealthy"
kill -STOP "$(main_pid "$coordinator")"
until_true 60 "unhealthy while it hangs" health_is unhealthy || true
kill -CONT "$(main_pid "$coordinator")"
until_true 60 "healthy again" health_is healthy || true
until_true 60 "three workers again" has_workers 3 || true

# As many samples as make the frame last for the night: paused for 75 s, and a while after it.
gleaner scene cornell-box -o "$place/box.glb" 2>/dev/null
# The first of two compiles the kernels.
for job in 1 2; do
  job=$(gleaner submit $(frame 64))
  rendered "$job" >/dev/null
done
seconds=$(sed -n 's/^  "seconds": \([0-9.]*\).*/\1/p' "$place/$job/frame_0001.json")
spp=$(awk -v s="$seconds" 'BEGIN { spp = 64; while (s < 120) { s *= 2; spp *= 2 } print spp }')
step "64 samples a pixel took $seconds s: the night has $spp"

job=$(gleaner submit $(frame "$spp"))
began=$SECONDS
until_true 60 "the frame begins" has_begun "$job" || true
step "one worker stands still, one is killed, one is cut off"
network=${GLEANER_PROJECT}_default
docker pause "${workers[0]}" >/dev/null
restarts=$(inspect "${workers[1]}" '{{.RestartCount}}')
kill -KILL "$(main_pid "${workers[1]}")"
docker network disconnect "$network" "${workers[2]}"
sleep 40
logged "$coordinator" "is gone: not heard of for 30 s" || fail "nobody noticed that workers are silent"
has_workers 1 || fail "expected that the killed worker alone is back, found $(connected) workers"
expect_same "restarts of the killed worker" $((restarts + 1)) "$(inspect "${workers[1]}" '{{.RestartCount}}')"
docker network connect --alias worker "$network" "${workers[2]}"
until_true 60 "the worker that was cut off is back" has_workers 2 || true
remaining=$((75 - (SECONDS - began)))
((remaining <= 0)) || sleep "$remaining"
running "$job" || fail "INCONCLUSIVE: the frame ended before the worker that stood still went on"
docker unpause "${workers[0]}" >/dev/null
until_true 60 "the worker that stood still is back" has_workers 3 || true
night=$(rendered "$job")
step "the frame took $((SECONDS - began)) s"
step "the same frame in one process"
expect_same "the picture after that night" "$(alone "$spp")" "$night"

step "a worker that is stopped hands in its batch; the coordinator's container starts anew"
small=$(alone 64)
job=$(gleaner submit $(frame 64))
until_true 60 "the frame begins" has_begun "$job" || true
began=$SECONDS
docker stop "${workers[0]}" >/dev/null # with the grace time of the compose file
expect_same "exit status of the stopped worker" 0 "$(inspect "${workers[0]}" '{{.State.ExitCode}}')"
((SECONDS - began < 60)) || fail "the worker took more than its grace time"
expect_same "the picture" "$small" "$(rendered "$job")"
docker start "${workers[0]}" >/dev/null
docker restart "$coordinator" >/dev/null
until_true 60 "healthy after a restart" health_is healthy || true
until_true 60 "workers reconnect" has_workers 3 || true
docker exec "$coordinator" test -s "/data/jobs/$job/frame_0001.exr" || fail "the volume lost a picture"
expect_same "the picture after a restart" "$small" "$(rendered "$(gleaner submit $(frame 64))")"

step "the end"
"$root/farm" down || fail "farm down"
[[ -z $(containers) ]] || fail "containers are left"
docker volume inspect "${GLEANER_PROJECT}_data" >/dev/null || fail "farm down took the pictures away"
exit "$failed"
