#!/usr/bin/env bash
# Tests the Python package in an environment of its own, against the program in target/debug. Skips
# aloud where there is no Python or PyPI cannot be reached. With CI=true that is a failure.
#
#     tools/python_package.sh                      builds the wheel with maturin and installs it, as users get it
#     tools/python_package.sh --workspace          takes the extension of the workspace's build, whose dependencies are
#                                                  compiled already: what the gate does after `cargo test --workspace`
#     tools/python_package.sh -k test_live -x      further arguments are pytest's
set -euo pipefail
cd "$(dirname "$0")/.."

if ! python=$(tools/python.sh --locked); then
    echo "python package: skipped: no environment of crates/languages/python/requirements.lock; are Python and PyPI there?" >&2
    [ "${CI:-}" != true ]
    exit
fi
target=${CARGO_TARGET_DIR:-$PWD/target}
if [ "${1:-}" = --workspace ]; then
    shift
    # Examples need what tests need: so the dependencies have the features that `cargo test
    # --workspace` compiled them with.
    cargo build --quiet --locked --workspace --lib --bins --examples
    package=$target/python-package
    rm -rf "$package"
    mkdir -p "$package"
    cp -r crates/languages/python/python/joulebus "$package"
    cp "$target/debug/lib_native.so" "$package/joulebus/_native.abi3.so"
    export PYTHONPATH=$package
else
    wheels=$target/wheels
    rm -rf "$wheels"
    # Both distributions: without the lab most tests have nothing to compare.
    for project in crates/languages/python crates/languages/python/lab; do
        (cd "$project" && "$python" -m maturin build --quiet --locked --profile dev --interpreter "$python" --out "$wheels")
    done
    [ -n "${JOULEBUS_PROGRAM:-}" ] || cargo build --quiet --locked --package joulebus --package joulebus-lab
    # The wheel, not the sources: a file that it lacks is found missing.
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$wheels"/*.whl
fi
# Nothing of the repository's folder is on the path of imports.
JOULEBUS_PROGRAM=${JOULEBUS_PROGRAM:-$target/debug/joulebus} \
    "$python" -P -m pytest --quiet --config-file crates/languages/python/pyproject.toml --rootdir crates/languages/python \
    -p no:cacheprovider crates/languages/python/tests "$@"
