#!/usr/bin/env bash
# Lints configs/container: the Containerfile by dockerfile-utils (npm), compose.yaml by podman-compose (PyPI), and that the
# verbs and options of its commands exist. With podman or docker it also builds the image and runs it.
#
#     tools/containers.sh
#
# Without npm or PyPI it prints what it skips; with CI=true that is a failure. Needs a `joulebus` of this build.
set -euo pipefail
cd "$(dirname "$0")/.."
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
tools=$target/tools/containers
file=configs/container/Containerfile
compose=configs/container/compose.yaml

skip() {
    echo "SKIPPED: tools/containers.sh: $1" >&2
    if [ "${CI:-}" = true ]; then exit 1; fi
}
fail() { echo "tools/containers.sh: $1" >&2; exit 1; }

mkdir -p "$tools"
if [ -x "$tools/node_modules/.bin/dockerfile-utils" ] \
    || npm install --silent --prefix "$tools" dockerfile-utils@0.16.3 > "$tools/npm.log" 2>&1; then
    "$tools/node_modules/.bin/dockerfile-utils" lint "$file" || fail "$file has errors"
    echo "$file: no errors"
else
    skip "dockerfile-utils cannot be installed by npm: $file is not linted"
fi

if [ -x "$tools/python/bin/podman-compose" ] || { python3 -m venv "$tools/python" \
    && "$tools/python/bin/python" -m pip install --quiet --disable-pip-version-check podman-compose==1.6.0; } > "$tools/pip.log" 2>&1; then
    # It asks podman for its version before it reads anything, and for nothing else here.
    mkdir -p "$tools/bin"
    printf '#!/bin/sh\necho "podman version 5.4.0"\n' > "$tools/bin/podman"
    chmod +x "$tools/bin/podman"
    PATH=$tools/bin:$PATH "$tools/python/bin/podman-compose" -f "$compose" config > "$tools/compose.yaml" 2> "$tools/compose.log" \
        || fail "$compose has errors: $(cat "$tools/compose.log")"
    joulebus=
    for folder in debug release dist; do
        if [ -x "$target/$folder/joulebus" ]; then joulebus=$target/$folder/joulebus; fi
    done
    [ -n "$joulebus" ] || fail "no joulebus was built: cargo build"
    "$tools/python/bin/python" - "$tools/compose.yaml" "$joulebus" << 'PYTHON' || fail "$compose does not fit the programs"
import subprocess
import sys

import yaml

compose, joulebus = yaml.safe_load(open(sys.argv[1])), sys.argv[2]
services, volumes = compose["services"], compose.get("volumes", {})
checked = 0
for name, service in services.items():
    for key in ("ipc", "pid"):
        of = service.get(key, "")
        assert not of.startswith("service:") or of[8:] in services, f"{name}: {key} of {of}"
    for volume in service.get("volumes", []):
        source = volume.split(":")[0] if isinstance(volume, str) else volume["source"]
        assert source.startswith((".", "/")) or source in volumes, f"{name}: no volume {source}"
    command = service.get("command")
    if service["image"] != "joulebus" or not command:
        continue
    verb = command[:2] if command[0] == "publish" else command[:1]
    help = subprocess.run([joulebus, *verb, "--help"], capture_output=True, text=True)
    assert help.returncode == 0, f"{name}: {verb}: {help.stderr}"
    for option in (word for word in command if word.startswith("--")):
        assert option in help.stdout, f"{name}: {' '.join(verb)} has no {option}"
        checked += 1
assert checked > 5, checked
print(f"{sys.argv[1]}: {len(services)} services, {checked} options exist")
PYTHON
else
    skip "podman-compose cannot be installed from PyPI: $compose is not linted"
fi

for builder in podman docker; do
    # A client without a daemon builds nothing.
    "$builder" info > /dev/null 2>&1 || continue
    "$builder" build --quiet -f "$file" -t joulebus .
    "$builder" run --rm joulebus --version
    exit
done
echo "tools/containers.sh: neither podman nor docker works here: the image was not built" >&2
