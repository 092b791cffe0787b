#!/usr/bin/env bash
# Writes power logs into a folder, as a user might have them: four runs of a robot with column names
# of its own and ROS's sign of the current.
#
#     tools/walks/logs.sh logs
set -euo pipefail
mkdir "$1"
for run in 1 2 3 4; do
    awk -v run=$run 'BEGIN {
        print "stamp,battery_u,battery_i,v_cmd,omega_cmd"
        for (row = 0; row < 900; row++) {
            step = row + 5000 * run
            v = 0.2 + 0.1 * sin(0.03 * step); i = 1.2 + 1.5 * v + 0.1 * sin(2.9 * step) + 0.05 * cos(0.7 * step)
            printf "%.3f,%.4f,%.4f,%.3f,%.3f\n", row / 30, 24 - 0.1 * i, -i, v, 0.5 * sin(0.02 * step)
        }
    }' >"$1/run$run.csv"
done
