#!/usr/bin/env bash
# Tests the Python package with the lowest versions that crates/languages/python/pyproject.toml
# allows, in the oldest Python that it allows. JAX is left out: it needs a newer NumPy.
#
#     tools/python_bounds.sh [arguments of pytest]
#
# Without that Python or PyPI it prints what it skips. With CI=true that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
home=$target/python-bounds
skip() { echo "python bounds: skipped: $1" >&2; [ "${CI:-}" != true ]; exit; }
oldest=${JOULEBUS_OLDEST_PYTHON:-python3.10}
"$oldest" -c '' 2>/dev/null || skip "no $oldest"
python3 - crates/languages/python/pyproject.toml >"$home.txt" <<'PYTHON'
import re
import sys
import tomllib

project = tomllib.load(open(sys.argv[1], "rb"))["project"]
assert project["requires-python"] == ">=3.10", project["requires-python"]
wanted = [*project["dependencies"], *sum(project["optional-dependencies"].values(), [])]
for requirement in sorted(set(wanted)):
    # joulebus-lab is of the same release.
    if found := re.fullmatch(r"([\w-]+)>=([\d.]+)", requirement):
        if found[1] != "jax":
            print(f"{found[1]}=={found[2]}")
PYTHON
if ! cmp --silent "$home.txt" "$home/made-from.txt"; then
    rm -rf "$home"
    { "$oldest" -m venv "$home" \
        && "$home/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary :all: -r "$home.txt"; } >&2 \
        || skip 'the packages cannot be installed'
    cp "$home.txt" "$home/made-from.txt"
fi
cargo build --quiet --locked --package joulebus-python --package joulebus --package joulebus-lab
package=$target/python-bounds-package
rm -rf "$package"
mkdir -p "$package"
cp -r crates/languages/python/python/joulebus "$package"
cp "$target/debug/lib_native.so" "$package/joulebus/_native.abi3.so"
"$home/bin/python" -m pip list --disable-pip-version-check --format freeze | grep -f <(cut -d= -f1 "$home.txt") | tr '\n' ' '
tests=$PWD/crates/languages/python
# Not from the repository's folder, which Python 3.10 would search for imports. Notebooks need more packages.
cd "$home"
PYTHONPATH=$package JOULEBUS_PROGRAM=$target/debug/joulebus "$home/bin/python" -m pytest --quiet \
    --config-file "$tests/pyproject.toml" --rootdir "$tests" -p no:cacheprovider --ignore "$tests/tests/test_notebooks.py" \
    "$tests/tests" "$@"
