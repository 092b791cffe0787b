#!/usr/bin/env bash
# From a data sheet, and from CSV logs, to a worker that forecasts, from an empty home: every command as a new user types
# it, with the time that it took.
#
#     tools/walks/csv.sh                    # builds the programs first
#     tools/walks/csv.sh --built [FOLDER]   # with those of target/release, or of a folder
#
# tools/walks/logs.sh makes the logs.
. "$(dirname "$0")/step.sh"
walk_builds csv 'joulebus joulebus-lab' "$@"
"$repository/tools/walks/logs.sh" logs

typed joulebus config init --power 30-200 --speed 1.2 --battery-wh 480 --name cart --out cart
typed joulebus config check cart/fleet.toml

# What is not recognised is named, with the option that states it.
! joulebus config init --from logs --out lab >out 2>&1 || { echo "a column of another name was guessed"; exit 1; }
grep -q -- '--map' out
reading=(--map time=stamp,voltage_V=battery_u,current_A=battery_i)
! joulebus config init --from logs --out lab "${reading[@]}" >out 2>&1 || { echo "the sign was not noticed"; exit 1; }
grep -q -- '--current discharge-negative' out
reading+=(--current discharge-negative)
typed joulebus data check logs "${reading[@]}"
typed joulebus config init --from logs --out lab --train --battery-wh 50 "${reading[@]}"
grep 'against the last reading' .out
own_domain lab/fleet.toml
typed joulebus config check lab/fleet.toml
background worker joulebus run --config lab/fleet.toml
step 'joulebus run --config lab/fleet.toml, until it is ready' seen worker ready
typed joulebus publish trial logs --config lab/fleet.toml --duration 10
typed joulebus watch --once --config lab/fleet.toml
walk_says 'a worker that forecasts from logs'
