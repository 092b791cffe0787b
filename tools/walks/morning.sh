#!/usr/bin/env bash
# The second morning (docs/how-to/second-morning.md): what a minute without a worker costs, who says so,
# and three ways to state what is left. Every command as a user types it, with the time that it took.
#
#     tools/walks/morning.sh                    # builds the program first
#     tools/walks/morning.sh --built [FOLDER]   # with that of target/release, or of a folder
#
# The batteries are small, so that a minute costs as much as a lunch.
. "$(dirname "$0")/step.sh"
walk_builds morning joulebus "$@"
export USER=walker
cat >fleet.toml <<TOML
[fleet]
name = "morning"
capacity = 8
[[platform]]
file = "builtin:gternal"
robots = ["0-7"]
[platform.battery]
capacity_wh = 0.6
initial_soc_lo = 0.9
TOML
own_domain fleet.toml
typed joulebus config check fleet.toml
background first joulebus run --config fleet.toml
step 'the worker is ready' seen first '^ready'
background robots joulebus publish sim --config fleet.toml --robots 4
typed until_says 'robot 3: [0-9]+ % ' joulebus battery --config fleet.toml
joulebus battery --config fleet.toml
! grep -q 'without readings' .says || { echo 'no pause has been'; exit 1; }

# The lunch: no worker for seventy seconds. The robots go on.
ended first
sleep 70
background second joulebus run --config fleet.toml
step 'the next worker is ready' seen second '^ready'
step 'it says what the pause may have cost' seen second 'robot 3: 1 min without readings may have cost up to [0-9]+ %'
grep -m 1 'without readings' .second.log
typed until_says 'battery 3 --full' joulebus battery 3 --config fleet.toml
cat .says
for through in memory worker; do
    typed until_says 'robot 3: [1-9] min without readings' joulebus ask --robot 3 --idle 10 --through $through --config fleet.toml
done

# What a person states.
typed joulebus battery 0 --full --by ann --config fleet.toml
typed joulebus battery 1 --charge .5 --by ann --config fleet.toml
typed joulebus battery 2 --exchanged --config fleet.toml
typed until_says '^robot 0: (9[0-9]|100) % \((9[0-9]|100) to 100\)$' joulebus battery 0 --config fleet.toml
typed until_says '^robot 1: (50|4[0-9]) % \([0-9]+ to [0-9]+\)$' joulebus battery 1 --config fleet.toml
typed until_says '^robot 2: (9[0-9]|100) % \([0-9]+ to 100\)$' joulebus battery 2 --config fleet.toml
step 'the worker says who stated it' seen second 'robot 2: battery exchanged, states walker'
! joulebus battery 77 --full --config fleet.toml >out 2>&1 || { echo 'no such robot'; exit 1; }
grep -q 'no platform of the config' out
walk_says 'the second morning'
