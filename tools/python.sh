#!/usr/bin/env bash
# Prints a Python with the packages that tests compare with: the system's if it has them, else an
# environment in target/python with pinned versions from PyPI, made when it is first needed.
#
#     JOULEBUS_PYTHON=$(tools/python.sh) cargo test --workspace
set -euo pipefail
cd "$(dirname "$0")/.."
if python3 -c 'import numpy, prometheus_client' 2>/dev/null; then
    command -v python3
    exit
fi
home=${CARGO_TARGET_DIR:-target}/python
if ! "$home/bin/python" -c 'import numpy, prometheus_client' 2>/dev/null; then
    echo "making $home" >&2
    python3 -m venv "$home"
    "$home/bin/python" -m pip install --quiet --disable-pip-version-check numpy==2.3.4 prometheus-client==0.23.1 >&2
fi
realpath --no-symlinks "$home/bin/python"
