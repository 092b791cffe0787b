#!/usr/bin/env bash
# Prints a Python with Eclipse Cyclone DDS and Eclipse zenoh, for the tests of `joulebus bridge`
# with ROS 2 (`JOULEBUS_CYCLONEDDS`): the system's if it has the package, else an environment in
# target/cyclonedds with the version and hashes of
# crates/gateways/bridge/tests/all/ros2/requirements.lock, from PyPI. Without one it prints nothing
# and says why. With CI=true that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."
if python3 -c 'import cyclonedds.domain, zenoh' 2>/dev/null; then
    command -v python3
    exit
fi
home=${CARGO_TARGET_DIR:-target}/cyclonedds
lock=crates/gateways/bridge/tests/all/ros2/requirements.lock
if ! cmp --silent "$lock" "$home/made-from.lock"; then
    rm -rf "$home"
    if ! { python3 -m venv "$home" && "$home/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps \
        --require-hashes --only-binary :all: --requirement "$lock"; } >&2; then
        echo "cyclonedds: skipped: there is no wheel of it for this machine, or no PyPI" >&2
        [ "${CI:-}" != true ]
        exit
    fi
    cp "$lock" "$home/made-from.lock"
fi
realpath --no-symlinks "$home/bin/python"
