#!/usr/bin/env bash
# From a data sheet, and from CSV logs, to a worker that forecasts, from an empty home: every command as a new user types
# it, with the time that it took.
#
#     tools/walks/csv.sh            # builds the programs first, and says how long that took
#     tools/walks/csv.sh --built    # with those of target/release
#
# tools/walks/logs.sh makes the logs. Ends with 1 if a step fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
repository=$PWD
programs=$PWD/target/release
home=$(mktemp -d)
worker=
trap '[ -z "$worker" ] || kill "$worker" 2>/dev/null || true; rm -rf "$home" "/dev/shm/jbwalk-$$"' EXIT

total_ms=0
took() { # what, since when
    local ms=$(($(date +%s%3N) - $2))
    total_ms=$((total_ms + ms))
    printf '%3d min %5.1f s  %s\n' $((ms / 60000)) "$(((ms % 60000) / 100))e-1" "$1"
}
step() {
    local begin
    begin=$(date +%s%3N)
    "$@" >"$home/out" 2>&1 || { cat "$home/out"; echo "failed: $*"; exit 1; }
    took "$*" "$begin"
}

if [ "${1:-}" != --built ]; then
    step cargo build --release --locked --quiet -p joulebus -p joulebus-lab
fi
export HOME=$home XDG_STATE_HOME=$home/state PATH=$programs:$PATH
cd "$home"
"$repository/tools/walks/logs.sh" logs

step joulebus config init --power 30-200 --speed 1.2 --battery-wh 480 --name cart --out cart
step joulebus config check cart/fleet.toml

# What is not recognised is named, with the option that states it.
! joulebus config init --from logs --out lab >out 2>&1 || { echo "a column of another name was guessed"; exit 1; }
grep -q -- '--map' out
reading=(--map time=stamp,voltage_V=battery_u,current_A=battery_i)
! joulebus config init --from logs --out lab "${reading[@]}" >out 2>&1 || { echo "the sign was not noticed"; exit 1; }
grep -q -- '--current discharge-negative' out
reading+=(--current discharge-negative)
step joulebus data check logs "${reading[@]}"
step joulebus config init --from logs --out lab --train --battery-wh 50 "${reading[@]}"
grep 'against the last reading' out
sed -i "s,^root = .*,root = \"/dev/shm/jbwalk-$$\"," lab/fleet.toml
step joulebus config check lab/fleet.toml
begin=$(date +%s%3N)
joulebus run --config lab/fleet.toml >worker.out 2>&1 &
worker=$!
until grep -q ready worker.out; do
    kill -0 "$worker" || { cat worker.out; exit 1; }
    sleep 0.05
done
took 'joulebus run --config lab/fleet.toml, until it is ready' "$begin"
step joulebus publish trial logs --config lab/fleet.toml --duration 10
step joulebus watch --once --config lab/fleet.toml
printf '%3d min %5.1f s  in all\n' $((total_ms / 60000)) "$(((total_ms % 60000) / 100))e-1"
