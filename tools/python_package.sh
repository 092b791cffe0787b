#!/usr/bin/env bash
# Builds the Python package with maturin, installs the wheel into an environment of its own and runs its tests
# against the program in target/debug. Arguments are passed on to pytest. Skips aloud where PyPI cannot be
# reached; with CI=true that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."

if ! python=$(tools/python.sh --locked); then
    echo "python package: skipped: no environment of crates/python/requirements.lock; is PyPI reachable?" >&2
    [ "${CI:-}" != true ]
    exit
fi
target=${CARGO_TARGET_DIR:-$PWD/target}
wheels=$target/wheels
rm -rf "$wheels"
# The profile of the tests: their dependencies are compiled already.
"$python" -m maturin build --quiet --locked --profile dev --manifest-path crates/python/Cargo.toml \
    --interpreter "$python" --out "$wheels"
cargo build --quiet --locked --package joulebus
# The wheel is installed as users get it, not the sources: a file that it lacks is found missing.
"$python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$wheels"/joulebus-*.whl
# Nothing of the repository's folder is on the path of imports.
JOULEBUS_PROGRAM=${JOULEBUS_PROGRAM:-$target/debug/joulebus} \
    "$python" -P -m pytest --quiet --config-file crates/python/pyproject.toml --rootdir crates/python \
    -p no:cacheprovider crates/python/tests "$@"
