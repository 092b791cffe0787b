#!/usr/bin/env bash
# Installs the wheels of both distributions into an environment of nothing else, and does their five
# minutes there.
#
#     tools/release/check_wheel.sh DIST VERSION                 # those of this processor
#     tools/release/check_wheel.sh DIST VERSION --foreign aarch64   # what can be read of another's without one
set -euo pipefail
dist=$(realpath "$1") version=$2 arch=$(uname -m)
here=$(dirname "$(realpath "$0")")
[ "${3:-}" != --foreign ] || arch=$4
fail() { echo "tools/release/check_wheel.sh: $1" >&2; exit 1; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
wheels=()
for name in joulebus joulebus_lab; do
    found=("$dist/$name-$version"-cp310-abi3-manylinux*"_$arch.whl")
    [ -f "${found[0]}" ] || fail "$dist has no wheel of $name for CPython 3.10 and later on $arch: manylinux"
    wheels+=("${found[0]}")
    mkdir "$work/$name"
    python3 -m zipfile -e "${found[0]}" "$work/$name"
    library=$(find "$work/$name" -name '_native*.so')
    readelf -h "$library" | grep -i "Machine:.*${arch//_/.}" >/dev/null || fail "$library is not of $arch"
    newest=$(readelf -V "$library" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -n 1)
    [ "$(printf '%s\n' "$newest" GLIBC_2.28 | sort -V | tail -n 1)" = GLIBC_2.28 ] || fail "$name needs $newest"
    ls "$work/$name/$name-$version.dist-info"/licenses/LICENSE-MIT >/dev/null || fail "$name has no licence"
    echo "$(basename "${found[0]}"): $(stat -c %s "${found[0]}") bytes, $newest" >&2
done
[ "$arch" = "$(uname -m)" ] || exit 0

python3 -m venv "$work/venv"
pip=("$work/venv/bin/python" -m pip --quiet --disable-pip-version-check)
cd "$work"
"${pip[@]}" install "${wheels[0]}"
"$work/venv/bin/python" "$here/first_yes.py"
"${pip[@]}" install "${wheels[1]}"
"$work/venv/bin/python" - <<'PYTHON'
import joulebus

trials = joulebus.simulate(1, steps=600).trials
print(joulebus.train(trials, split="time", max_epochs=2), joulebus.evaluate(trials[5]))
with joulebus.demo(3) as demo:
    assert demo.planner.ask(2, idle_s=60.0)[0].verdict == "yes"
PYTHON
