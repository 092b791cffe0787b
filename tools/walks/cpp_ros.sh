#!/usr/bin/env bash
# From nothing to an echo, as who has robots on ROS 2 and writes C++: libjoulebus-dev of dist/,
# `find_package`, a bridge without a file.
#
#     tools/walks/cpp_ros.sh
#
# The package is unpacked into the home: tools/release.sh installs it. Where there is no ROS 2, its
# robots and its echo are a participant of Eclipse Cyclone DDS (tools/cyclonedds.sh). What is
# missing is skipped aloud. With CI=true that is a failure.
. "$(dirname "$0")/step.sh"
cyclonedds=$("$repository/tools/cyclonedds.sh" || true)
walk_begins cpp_ros
export PATH=$home/joulebus/bin:$PATH ROS_DOMAIN_ID=$((100 + $$ % 100))
skip() {
    echo "SKIPPED: tools/walks/cpp_ros.sh: $1" >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
}

step 'the programs are unpacked' unpack_programs
cat >fleet.toml <<'TOML'
[fleet]
name = "lab"
[[platform]]
file = "builtin:gternal"
robots = ["0-9"]
TOML
own_domain fleet.toml
background worker joulebus run --config fleet.toml
step 'the worker is ready' seen worker '^ready'
# Of several names it finds any one.
if { command -v cmake && command -v c++ && command -v dpkg-deb; } >/dev/null; then
    step 'libjoulebus-dev is unpacked' dpkg-deb -x "$(ls "$dist/libjoulebus-dev_$version-1_$(dpkg --print-architecture).deb")" library
    step 'joulebus new planner --lang cpp' joulebus new planner --lang cpp planner
    cp fleet.toml planner/configs/fleet.toml
    step 'cmake finds the library' cmake -S planner -B planner/build -DCMAKE_BUILD_TYPE=Release -DCMAKE_PREFIX_PATH="$home/library/usr"
    step 'cmake --build' cmake --build planner/build
    background planner planner/build/planner fleet.toml
    step 'the planner waits for robots' seen planner .
else
    skip 'no cmake, c++ or dpkg-deb: no program in C++'
fi
background bridge joulebus bridge ros2 --robots 'robot{id}=0-9' --config fleet.toml
step 'joulebus bridge ros2, without a file, prints its mapping' seen bridge 'battery_state'
cat .bridge.log
if command -v ros2 >/dev/null; then
    background battery ros2 topic pub --rate 30 /robot3/battery_state sensor_msgs/msg/BatteryState '{voltage: 4.0, current: -0.9, present: true}'
    background command ros2 topic pub --rate 30 /robot3/cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.1}}'
    background echo ros2 topic echo /robot3/joulebus/power_w
    step 'ros2 topic echo /robot3/joulebus/power_w' seen echo 'data: [0-9]'
elif [ -n "$cyclonedds" ]; then
    mkfifo orders
    exec 3<>orders
    # Of a process in the background the standard input is empty, unless it is said there.
    background echo bash -c 'exec "$@" <orders' - "$cyclonedds" "$repository/crates/gateways/bridge/tests/all/ros2/peer.py" "$ROS_DOMAIN_ID"
    cat >&3 <<'ORDERS'
{"say": "/robot3/battery_state", "type": "BatteryState", "fields": {"voltage": 4.0, "current": -0.9, "present": true}}
{"say": "/robot3/cmd_vel", "type": "Twist", "fields": {"linear": {"x": 0.1}}}
{"hear": "/robot3/joulebus/power_w", "type": "Float64"}
ORDERS
    step 'an echo of /robot3/joulebus/power_w (Cyclone DDS in place of ros2 topic echo)' seen echo '"data": [0-9]'
else
    skip 'neither ros2 nor Cyclone DDS is here: no echo'
fi
grep -m 1 'data"*: [0-9]' .echo.log || true
[ -z "${pid_planner:-}" ] || { step 'the planner in C++ prints forecasts of the same robots' seen planner '^tick.* [1-9][0-9]* robots, [1-9]' && grep -m 1 '^tick.* [1-9][0-9]* robots, [1-9]' .planner.log; }
walk_says 'find_package, and forecasts of ROS 2 robots without a file'
