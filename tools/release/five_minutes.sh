#!/usr/bin/env bash
# The first five minutes of who has installed the programs: the demo, then a worker with robots
# whose planner is told "yes".
#
#     tools/release/five_minutes.sh COMMAND…      # the command that runs `joulebus`: `joulebus`, or `chroot DIR joulebus`
#
# FIVE_MINUTES_ROOT names the folder that is / to that command. The files that it reads are written
# there.
set -euo pipefail
joulebus=("$@")
root=${FIVE_MINUTES_ROOT:-}
folder=$(mktemp -d -p "$root/tmp")
inside=${folder#"$root"}
mark=$(($$ % 1000000))
worker='' source=''
ended() {
    for process in $source $worker; do kill "$process" 2>/dev/null && wait "$process" || true; done
    rm -rf "$folder" "/dev/shm/five-$$" /dev/shm/f${mark}_*
}
trap ended EXIT
fail() { echo "five minutes: $1" >&2; exit 1; }

"${joulebus[@]}" --version
"${joulebus[@]}" demo --duration 5 --no-capture --plain --format json >"$folder/demo" || fail "the demo ended with $?"
grep -q accepted "$folder/demo" || fail "the demo accounts for nothing: $(head -c 500 "$folder/demo")"

cat >"$folder/fleet.toml" <<TOML
[fleet]
name = "five"
[domain]
root = "/dev/shm/five-$$"
prefix = "f${mark}_"
[[platform]]
file = "builtin:gternal"
robots = ["0-19"]
TOML
printf 'x_m,y_m\n0,0\n1,0\n' >"$folder/out.csv"
"${joulebus[@]}" run --config "$inside/fleet.toml" 2>"$folder/worker" &
worker=$!
until grep -q '^ready' "$folder/worker"; do
    kill -0 "$worker" 2>/dev/null || fail "the worker ended: $(cat "$folder/worker")"
    sleep 0.1
done
"${joulebus[@]}" publish sim --config "$inside/fleet.toml" >/dev/null 2>"$folder/source" &
source=$!
for _ in $(seq 300); do
    "${joulebus[@]}" ask --config "$inside/fleet.toml" --robot 7 --path "$inside/out.csv" --return dock >"$folder/answer" 2>&1 || true
    ! grep -q ': yes$' "$folder/answer" || { sed -n 1,3p "$folder/answer"; exit; }
    kill -0 "$source" 2>/dev/null || fail "the robots ended: $(cat "$folder/source")"
    sleep 0.2
done
fail "no answer is yes: $(cat "$folder/answer")"
