#!/usr/bin/env bash
# Builds and installs the source distribution as pip does, in an environment of nothing else, and
# does its five minutes there. Fails if that takes more than four minutes of a processor.
#
#     tools/release/check_sdist.sh DIST VERSION
#
# The registry of Cargo is this machine's. Beside other work it takes up to twice the time of a
# processor: judge it on a quiet machine.
set -euo pipefail
sdist=$(realpath "$1/joulebus-$2.tar.gz")
here=$(dirname "$(realpath "$0")")
limit_s=240
fail() { echo "tools/release/check_sdist.sh: $1" >&2; exit 1; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
# Nothing that was compiled before.
unset CARGO_TARGET_DIR CARGO_BUILD_TARGET_DIR RUSTFLAGS
python3 -m venv venv
begun=$SECONDS
TMPDIR=$work python3 - venv/bin/python -m pip install --quiet --disable-pip-version-check "$sdist" <<'PYTHON' >cpu_s || fail 'it does not install'
import resource
import subprocess
import sys

code = subprocess.run(sys.argv[1:], stdin=subprocess.DEVNULL, stdout=sys.stderr).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(round(used.ru_utime + used.ru_stime))
sys.exit(code)
PYTHON
echo "pip install $(basename "$sdist"): $(cat cpu_s) s of a processor, of at most $limit_s, after $((SECONDS - begun)) s, at load $(cut -d' ' -f1 /proc/loadavg)"
venv/bin/python "$here/first_yes.py"
[ "$(cat cpu_s)" -le "$limit_s" ] || fail "installing from source took $(cat cpu_s) s of a processor, at most $limit_s are promised"
