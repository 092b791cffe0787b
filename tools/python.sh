#!/usr/bin/env bash
# Prints a Python with the packages that tests compare with: the system's if it has them, else an
# environment in target/python with the versions and hashes of
# crates/languages/python/requirements.lock, from PyPI, made when it is first needed. With --locked
# it is always that environment.
#
#     JOULEBUS_PYTHON=$(tools/python.sh) cargo test --workspace
set -euo pipefail
cd "$(dirname "$0")/.."
if [ "${1:-}" != --locked ] && python3 -c 'import numpy, prometheus_client, rosbags' 2>/dev/null; then
    command -v python3
    exit
fi
home=${CARGO_TARGET_DIR:-target}/python
lock=crates/languages/python/requirements.lock
# The environment is that of this lock file, and whole.
if ! cmp --silent "$lock" "$home/made-from.lock"; then
    echo "making $home" >&2
    rm -rf "$home"
    python3 -m venv "$home"
    "$home/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes --only-binary :all: \
        --requirement "$lock" >&2
    cp "$lock" "$home/made-from.lock"
fi
realpath --no-symlinks "$home/bin/python"
