#!/usr/bin/env bash
# The entry script with stand-ins for the programs that it runs: what it prints, its exit status, and that it never leaves a
# process or a folder behind, however it ends. Usage: farm_script.sh PROJECT_ROOT
set -euo pipefail

root=$1
place=$(mktemp -d)
failed=0
fail() {
  printf 'FAILED: %s\n' "$*"
  failed=1
}

# Processes of the stand-ins carry the temporary folder in their command line; zombies have none.
survivors() { # survivors [NAME]
  { grep -lsaF "stand-in $place ${1:-}" /proc/[0-9]*/cmdline || true; } | cut -d / -f 3
}

finish() {
  local pid
  for pid in $(survivors); do kill -KILL "$pid" 2>/dev/null || true; done
  rm -rf "$place"
}
trap finish EXIT

expect_nothing_left() { # expect_nothing_left WHAT
  local i left=
  for ((i = 0; i < 100; ++i)); do
    left=$(survivors)
    [[ -n $left ]] || break
    sleep 0.05
  done
  [[ -z $left ]] || fail "$1: these processes are still there: $left"
}

expect_no_scratch() { # expect_no_scratch WHAT
  local left
  left=$(find "$place/.farm" -maxdepth 1 -name 'run-*')
  [[ -z $left ]] || fail "$1: left behind: $left"
}

expect_text() { # expect_text WHAT FILE TEXT
  grep -qF -- "$3" "$2" || { fail "$1: expected '$3' in:"; cat "$2"; }
}

stand_in() { # stand_in PATH; its text comes on standard input
  { echo '#!/usr/bin/env bash'; cat; } >"$place/$1"
  chmod +x "$place/$1"
}

mkdir -p "$place"/{build/bin,tools,deploy,bench}
cp "$root/farm" "$place/farm"
touch "$place/build/build.ninja"
echo '# none' >"$place/deploy/packages-debian12.txt"
stand_in tools/ninja <<<'true'
stand_in tools/sudo <<<'[[ $1 == -v ]] || exec "$@"'
stand_in build/bin/gleaner <<'E2'
case $1 in
  submit) echo "$*" >>"$SUBMITTED"; echo job-1 ;;
  fetch) # as the real one, which writes over nothing
    [[ ! -e $4/frame_0001.exr || $* == *--force* ]] || exit 1
    mkdir -p "$4"
    touch "$4/frame_0001.exr" "$4/frame_0001.png"
    printf '{\n  "rays": {\n    "camera": 1,\n    "total": 3000000\n  },\n  "seconds": 1.5\n}\n' >"$4/frame_0001.json"
    ;;
  compare) printf '{\n  "mean": 2.0,\n  "standard_error": 0.0125\n}\n' ;;
esac
E2
stand_in build/bin/gleaner-coordinator <<E2
echo "\$*" >"$place/coordinator-words"
echo 127.0.0.1:1
exec -a "stand-in $place coordinator" sleep 1000
E2
stand_in build/bin/gleaner-worker <<E2
# With a child of its own, which must go too.
(exec -a "stand-in $place child" sleep 1000) &
(exec -a "stand-in $place worker" sleep 1000)
E2
export PATH="$place/tools:$PATH" SUBMITTED="$place/submitted"
log=$place/log
farm=$place/farm

# denoiser: an error where it cannot be fetched; all else only says so.
echo 'wanted==1' >"$place/deploy/denoiser.txt"
stand_in deploy/fetch-denoiser.sh <<<'echo "no such host" >&2; exit 1'
status=0
"$farm" denoiser >"$log" 2>&1 || status=$?
((status == 1)) || fail "denoiser: exit status $status where PyPI is not reached"
expect_text denoiser "$log" 'no such host'
"$farm" demo >"$log" 2>&1 || fail "demo without a denoiser: exit status $?"
expect_text 'demo without a denoiser' "$log" 'the denoiser could not be fetched'
grep -q -- --denoise "$SUBMITTED" && fail "demo without a denoiser: asks for one"

# demo: from start to end.
stand_in deploy/fetch-denoiser.sh <<<'mkdir -p "$1" && cp deploy/denoiser.txt "$1"'
"$farm" demo >"$log" 2>&1 || fail "demo: exit status $?"
expect_text demo "$log" 'rendered in 1.50 s: 3.0 million rays, 2.0 million a second; expected error 1.25 % of the mean'
expect_text demo "$log" "$place/demo-output/frame_0001.png"
expect_text demo "$SUBMITTED" '--denoise'
expect_nothing_left demo
expect_no_scratch demo
stand_in deploy/fetch-denoiser.sh <<<'exit 1'
"$farm" denoiser >"$log" 2>&1 || fail "denoiser: fetched again"

# up: until it is told to end, in whatever way.
set -m # else background processes ignore SIGINT
for signal in INT TERM HUP KILL; do
  "$farm" up 2 >"$log" 2>&1 &
  pid=$!
  for ((i = 0; i < 200; ++i)); do
    if grep -q 'listens on' "$log" && (($(survivors | wc -l) == 5)); then break; fi
    sleep 0.05
  done
  ((i < 200)) || fail "up: expected a coordinator and two workers with a child each, found $(survivors | wc -l)"
  kill -"$signal" "$pid"
  status=0
  wait "$pid" 2>/dev/null || status=$?
  ((status == 128 + $(kill -l "$signal"))) || fail "up: exit status $status after SIG$signal"
  if [[ $signal == KILL ]]; then
    # The children of the children are out of reach then.
    for ((i = 0; i < 100; ++i)); do
      if [[ -z $(survivors coordinator) ]]; then break; fi
      sleep 0.05
    done
    ((i < 100)) || fail "up: the coordinator outlived SIGKILL"
    for left in $(survivors); do kill -KILL "$left" 2>/dev/null || true; done
    rm -rf "$place"/.farm/run-*
  else
    expect_nothing_left "up, SIG$signal"
    expect_no_scratch "up, SIG$signal"
  fi
done
set +m

# up: a worker that ends takes the farm down, and it says so.
mv "$place/build/bin/gleaner-worker" "$place/worker"
stand_in build/bin/gleaner-worker <<<'exit 1'
status=0
"$farm" up 1 >"$log" 2>&1 || status=$?
((status == 1)) || fail "up: exit status $status where a worker ended"
expect_text 'up without workers' "$log" 'a process of the farm ended'
expect_nothing_left 'up without workers'

# up --insecure, GLEANER_HTTP: said to the coordinator, which decides.
GLEANER_LISTEN=0.0.0.0:8780 GLEANER_HTTP=127.0.0.1:8781 "$farm" up --insecure 1 >"$log" 2>&1 || true
expect_text 'up --insecure' "$place/coordinator-words" '--listen 0.0.0.0:8780'
expect_text 'up --insecure' "$place/coordinator-words" '--insecure --http 127.0.0.1:8781'
expect_text 'up --insecure' "$log" 'in a browser: http://127.0.0.1:8781/'
for words in '--insecur' '0' '-1' '3 x'; do
  status=0
  # shellcheck disable=SC2086 # several words are meant
  "$farm" up $words >"$log" 2>&1 || status=$?
  ((status == 1)) || fail "up $words: exit status $status"
  expect_text "up $words" "$log" 'expected a number of workers, --docker or --insecure'
done
mv "$place/worker" "$place/build/bin/gleaner-worker"

# up --docker: what the engine is told, and with what.
stand_in tools/docker <<E2
echo "docker \$*; BIND=\${GLEANER_BIND:-} PORT=\${GLEANER_PORT:-} HTTP=\${GLEANER_HTTP_BIND:-}:\${GLEANER_HTTP_PORT:-}" >>"$place/docker"
case "\$*" in
  *'exec -T coordinator gleaner workers'*) printf 'one\ntwo\nthree\n' ;;
  *build) [[ ! -e "$place/no-image" ]] ;;
esac
E2
"$farm" up --docker 3 >"$log" 2>&1 || fail "up --docker: exit status $?"
expect_text 'up --docker' "$place/docker" 'compose -p gleaner -f deploy/docker-compose.yml build; BIND=127.0.0.1 PORT=8780'
expect_text 'up --docker' "$place/docker" 'up -d --no-build --scale worker=3;'
expect_text 'up --docker' "$log" 'export GLEANER_COORDINATOR=127.0.0.1:8780'
expect_text 'up --docker' "$log" 'in a browser: http://127.0.0.1:8781/'
GLEANER_LISTEN=0.0.0.0:9000 GLEANER_HTTP=127.0.0.1:9001 "$farm" up 3 --docker --insecure >"$log" 2>&1 ||
  fail "up --docker --insecure: exit status $?"
expect_text 'up --docker' "$place/docker" 'worker=3; BIND=0.0.0.0 PORT=9000 HTTP=127.0.0.1:9001'
expect_text 'up --docker' "$log" 'export GLEANER_COORDINATOR=127.0.0.1:9000'
expect_text 'up --docker' "$log" 'in a browser: http://127.0.0.1:9001/'
rm "$place/docker"
for variable in GLEANER_LISTEN GLEANER_HTTP; do
  status=0
  env "$variable=0.0.0.0:8780" "$farm" up --docker >"$log" 2>&1 || status=$?
  ((status == 1)) || fail "up --docker, $variable open to others: exit status $status"
  expect_text "up --docker, $variable" "$log" 'say --insecure'
done
! grep -q 'up -d' "$place/docker" || fail 'up --docker: it started a farm open to others'
"$farm" down >"$log" 2>&1 || fail "down: exit status $?"
expect_text down "$place/docker" '-f deploy/docker-compose.yml down'
touch "$place/no-image"
status=0
"$farm" up --docker >"$log" 2>&1 || status=$?
((status == 1)) || fail "up --docker: exit status $status where the image cannot be built"
expect_text 'up --docker' "$log" 'building the image failed'
stand_in tools/docker <<<'echo "Cannot connect to the Docker daemon" >&2; exit 1'
status=0
"$farm" up --docker >"$log" 2>&1 || status=$?
((status == 1)) || fail "up --docker: exit status $status without an engine"
expect_text 'up --docker' "$log" 'no Docker engine answers: Cannot connect'
expect_nothing_left 'up --docker'

# test: ctest's last line and its exit status.
stand_in tools/ctest <<<'echo "the arguments: $*"; echo "100% tests passed"; exit 7'
status=0
"$farm" test -R film >"$log" 2>&1 || status=$?
((status == 7)) || fail "test: exit status $status, expected ctest's 7"
[[ $(tail -n 1 "$log") == '100% tests passed' ]] || fail "test: the last line is not ctest's"
expect_text test "$log" '-R film'
expect_no_scratch test

# build: only what is missing is installed; what fails is shown.
printf 'present # a comment\nabsent\n' >"$place/deploy/packages-debian12.txt"
stand_in tools/dpkg-query <<<'echo "ii  present"; echo "un  absent"; exit 1'
stand_in tools/apt-get <<<'echo "apt-get $*" >>"'"$place"'/apt"'
"$farm" build >"$log" 2>&1 || fail "build: exit status $?"
[[ $(cat "$place/apt") == *'update'*$'\n'*'install -y --no-install-recommends absent' ]] ||
  fail "build: apt-get was called otherwise: $(cat "$place/apt")"
stand_in tools/ninja <<<'echo "error: no such thing"; exit 3'
status=0
"$farm" build >"$log" 2>&1 || status=$?
((status == 1)) || fail "build: exit status $status where ninja failed"
expect_text build "$log" 'error: no such thing'
expect_no_scratch build

status=0
"$farm" dance >"$log" 2>&1 || status=$?
((status == 2)) || fail "dance: exit status $status, expected 2"

exit "$failed"
