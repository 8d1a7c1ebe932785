#!/usr/bin/env bash
# A farm of three hosts, one of them behind NAT, in network namespaces: the commands of docs/how-to/farm-on-three-hosts.md. Needs
# root, ip and nft. Usage: hosts.sh PROJECT_ROOT PROGRAMS_DIR
set -euo pipefail
source "$(dirname "$0")/common.sh"
programs=$2
((EUID == 0)) || skip "network namespaces need root"
command -v ip >/dev/null || skip "no ip here"
command -v nft >/dev/null || skip "no nft here"
place=$(mktemp -d)
tag=g$$
ip netns add "$tag-a" 2>/dev/null || skip "network namespaces cannot be made here"
pids=()
finish() {
  local pid name
  for pid in ${pids[@]+"${pids[@]}"}; do kill -KILL "$pid" 2>/dev/null || true; done
  for name in a b c router; do ip netns del "$tag-$name" 2>/dev/null || true; done
  rm -rf "$place"
}
trap finish EXIT

# a and b lie in one network, 198.18.20.0/24, with a router behind which c lies, in 198.18.21.0/24: c's packets go out under the
# router's address, and nobody outside knows a way to c.
on() { ip netns exec "$tag-$1" "${@:2}"; }
for name in b c router; do ip netns add "$tag-$name"; done
for name in a b c router; do ip -n "$tag-$name" link set lo up; done
ip -n "$tag-router" link add outside type bridge
ip -n "$tag-router" link set outside up
ip -n "$tag-router" addr add 198.18.20.254/24 dev outside
connect() { # connect HOST ADDRESS PORT: a cable from the host to a port of the router
  ip link add e0 netns "$tag-$1" type veth peer name "$3" netns "$tag-router"
  ip -n "$tag-$1" addr add "$2/24" dev e0
  ip -n "$tag-$1" link set e0 up
  ip -n "$tag-router" link set "$3" up
}
connect a 198.18.20.1 to-a
connect b 198.18.20.2 to-b
connect c 198.18.21.3 to-c
ip -n "$tag-router" link set to-a master outside
ip -n "$tag-router" link set to-b master outside
ip -n "$tag-router" addr add 198.18.21.254/24 dev to-c
ip -n "$tag-c" route add default via 198.18.21.254
on router sysctl -qw net.ipv4.ip_forward=1
on router nft -f - <<'NFT'
table ip nat {
  chain out { type nat hook postrouting priority 100; ip saddr 198.18.21.0/24 oifname "outside" masquerade; }
}
NFT
! on a ping -c 1 -W 1 198.18.21.3 >/dev/null 2>&1 || fail "c can be reached: it does not lie behind NAT"

start() { # start HOST LOG COMMAND...
  # Not by on(): $! would be a shell's around the program, which outlives it.
  ip netns exec "$tag-$1" "${@:3}" >"$place/$2.out" 2>"$place/$2.log" &
  pids+=($!)
}
gleaner() { on b "$programs/gleaner" "$@"; } # people sit at the second host
has_workers() { (($(gleaner workers | wc -l) == $1)); }

step "in the clear the coordinator refuses other machines"
status=0
on a timeout 20 "$programs/gleaner-coordinator" --listen 198.18.20.1:8780 --data "$place/data" 2>"$place/refused" || status=$?
expect_same "exit status" 2 "$status"
grep -q -- --insecure "$place/refused" || fail "it does not say how: $(cat "$place/refused")"

step "a coordinator, a worker on each host"
start a coordinator "$programs/gleaner-coordinator" --listen 198.18.20.1:8780 --http 198.18.20.1:8781 --insecure --data "$place/data"
export GLEANER_COORDINATOR=198.18.20.1:8780 POCL_MAX_PTHREAD_COUNT=1
until_true 30 "the coordinator answers" on b "$programs/gleaner-coordinator" --check 198.18.20.1:8780 || exit 1
for name in a b c; do start "$name" "worker-$name" "$programs/gleaner-worker" --threads 1 --name "$name"; done
until_true 120 "three workers" has_workers 3 || exit 1

step "a frame, and the same in one process"
"$programs/gleaner" scene cornell-box -o "$place/box.glb" 2>/dev/null
job=$(gleaner submit "$place/box.glb" --size 256x256 --spp 64 --seed 7)
gleaner watch "$job" >"$place/watch" 2>&1 || fail "watch: $(tail -n 1 "$place/watch")"
gleaner fetch "$job" -o "$place/pictures" >/dev/null
"$programs/gleaner" render "$place/box.glb" --size 256x256 --spp 64 --seed 7 -o "$place/alone.exr" --report "$place/alone.json" --quiet
expect_same "the picture" "$(sha_of "$place/alone.json")" "$(sha_of "$place/pictures/frame_0001.json")"
for name in a b c; do
  grep -q "\"$name\": {" "$place/pictures/frame_0001.json" || fail "the worker of host $name did nothing"
done
gleaner workers --json | grep '"address":"ipv4:198.18.20.254:' >/dev/null || fail "host c does not come by the router's address"

step "host c loses its network for a while, in the middle of a frame"
job=$(gleaner submit "$place/box.glb" --size 256x256 --spp 512 --seed 7)
until_true 60 "the frame begins" eval "gleaner show $job --json | grep '\"items_done\":[1-9]' >/dev/null" || true
ip -n "$tag-router" link set to-c down
until_true 60 "the farm notices" has_workers 2 || true
ip -n "$tag-router" link set to-c up
ip -n "$tag-router" addr show dev to-c | grep 198.18.21.254 >/dev/null || fail "the router lost its address"
until_true 90 "host c is back" has_workers 3 || true
gleaner watch "$job" >"$place/watch" 2>&1 || fail "watch: $(tail -n 1 "$place/watch")"
gleaner fetch "$job" -o "$place/night" >/dev/null
"$programs/gleaner" render "$place/box.glb" --size 256x256 --spp 512 --seed 7 -o "$place/alone.exr" --report "$place/alone.json" --quiet
expect_same "the picture" "$(sha_of "$place/alone.json")" "$(sha_of "$place/night/frame_0001.json")"

exit "$failed"
