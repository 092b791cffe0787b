#!/usr/bin/env bash
# The second morning (docs/how-to/second-morning.md): what a minute without a worker costs, who says so,
# and three ways to state what is left. Every command as a user types it, with the time that it took.
#
#     tools/walks/morning.sh                    # builds the program first
#     tools/walks/morning.sh --built [FOLDER]   # with that of target/release, or of a folder
#
# The batteries are small, so that a minute costs as much as a lunch. Ends with 1 if a step fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
programs=$PWD/target/release
home=$(mktemp -d)
processes=()
trap 'for one in "${processes[@]}"; do kill "$one" 2>/dev/null && wait "$one" 2>/dev/null || true; done; rm -rf "$home" "/dev/shm/jbmorning-$$"' EXIT

took() { # what, since when
    local ms=$(($(date +%s%3N) - $2))
    printf '%3d min %5.1f s  %s\n' $((ms / 60000)) "$(((ms % 60000) / 100))e-1" "$1"
}
step() {
    local begin
    begin=$(date +%s%3N)
    "$@" >"$home/out" 2>&1 || { cat "$home/out"; echo "failed: $*"; exit 1; }
    took "$*" "$begin"
}
until_says() { # pattern, command…
    local pattern=$1
    shift
    for _ in $(seq 600); do
        "$@" >"$home/says" 2>&1 || true
        ! grep -qE "$pattern" "$home/says" || return 0
        sleep 0.2
    done
    cat "$home/says"
    return 1
}
worker() {
    joulebus run --config fleet.toml >"$home/$1.log" 2>&1 &
    processes+=($!)
    until_says '^ready' cat "$home/$1.log"
}

if [ "${1:-}" != --built ]; then
    step cargo build --release --locked --quiet -p joulebus
else
    programs=$(realpath "${2:-$programs}")
fi
export HOME=$home XDG_STATE_HOME=$home/state PATH=$programs:$PATH USER=walker
cd "$home"
begin=$(date +%s%3N)
cat >fleet.toml <<TOML
[fleet]
name = "morning"
capacity = 8
[domain]
root = "/dev/shm/jbmorning-$$"
[[platform]]
file = "builtin:gternal"
robots = ["0-7"]
[platform.battery]
capacity_wh = 0.6
initial_soc_lo = 0.9
TOML
step joulebus config check fleet.toml
worker first
joulebus publish sim --config fleet.toml --robots 4 >robots.log 2>&1 &
processes+=($!)
step until_says 'robot 3: [0-9]+ % ' joulebus battery --config fleet.toml
joulebus battery --config fleet.toml
! grep -q 'without readings' says || { echo 'no pause has been'; exit 1; }

# The lunch: no worker for seventy seconds. The robots go on.
kill "${processes[0]}" && wait "${processes[0]}" || true
sleep 70
worker second
step until_says 'robot 3: 1 min without readings may have cost up to [0-9]+ %' cat "$home/second.log"
grep 'without readings' "$home/second.log" | head -n 1
step until_says 'battery 3 --full' joulebus battery 3 --config fleet.toml
cat says
for through in memory worker; do
    step until_says 'robot 3: [1-9] min without readings' joulebus ask --robot 3 --idle 10 --through $through --config fleet.toml
done

# What a person states.
step joulebus battery 0 --full --by ann --config fleet.toml
step joulebus battery 1 --charge .5 --by ann --config fleet.toml
step joulebus battery 2 --exchanged --config fleet.toml
step until_says '^robot 0: (9[0-9]|100) % \((9[0-9]|100) to 100\)$' joulebus battery 0 --config fleet.toml
step until_says '^robot 1: (50|4[0-9]) % \([0-9]+ to [0-9]+\)$' joulebus battery 1 --config fleet.toml
step until_says '^robot 2: (9[0-9]|100) % \([0-9]+ to 100\)$' joulebus battery 2 --config fleet.toml
step until_says 'robot 2: battery exchanged, states walker' cat "$home/second.log"
! joulebus battery 77 --full --config fleet.toml >out 2>&1 || { echo 'no such robot'; exit 1; }
grep -q 'no platform of the config' out
took 'the second morning' "$begin"
