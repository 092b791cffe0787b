#!/usr/bin/env bash
# Lints configs/container: the Containerfile by dockerfile-utils (npm), compose.yaml by
# podman-compose (PyPI), and that the verbs and options of its commands exist, those of the launch
# file of ROS 2 and of the units of systemd, too, and that Grafana's
# provisioning fits it. With podman or docker it also builds the image and runs it.
#
#     tools/containers.sh
#
# Without npm or PyPI it prints what it skips. With CI=true that is a failure. Needs a `joulebus` of
# this build.
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
    "$tools/python/bin/python" - "$tools/compose.yaml" "$joulebus" "$file" << 'PYTHON' || fail "$compose does not fit the programs"
import json
import pathlib
import re
import subprocess
import sys
import xml.etree.ElementTree

import yaml

compose, joulebus = yaml.safe_load(open(sys.argv[1])), sys.argv[2]
services, volumes = compose["services"], compose.get("volumes", {})
checked = 0


def check(name, command):
    """The verb and the options of a container's command exist."""
    global checked
    verb = command[:2] if command[0] == "publish" else command[:1]
    help = subprocess.run([joulebus, *verb, "--help"], capture_output=True, text=True)
    assert help.returncode == 0, f"{name}: {verb}: {help.stderr}"
    for option in (word for word in command if word.startswith("--")):
        assert option in help.stdout, f"{name}: {' '.join(verb)} has no {option}"
        checked += 1


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
    check(name, command)
assert checked > 5, checked
print(f"{sys.argv[1]}: {len(services)} services, {checked} options exist")

# The pod: its volumes exist, all containers have /dev/shm, and its commands and probes exist.
pod = yaml.safe_load(pathlib.Path("configs/container/kubernetes.yaml").read_text())["spec"]
claims = [claim["metadata"]["name"] for claim in pod["volumeClaimTemplates"]]
pod = pod["template"]["spec"]
assert pod["shareProcessNamespace"]
for container in pod["containers"]:
    name, places = container["name"], {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
    assert places["/dev/shm"] == "shm" and set(places.values()) <= {*claims, *(volume["name"] for volume in pod["volumes"])}, name
    check(name, container["args"])
    if probe := container.get("readinessProbe"):
        check(name, probe["exec"]["command"][1:])
# And the health of the image.
health = next(line for line in open(sys.argv[3]) if line.strip().startswith("CMD [") and "watch" in line)
check("HEALTHCHECK", json.loads(health.strip()[4:])[1:])
print(f"configs/container/kubernetes.yaml: {len(pod['containers'])} containers")

# The commands of ROS 2's launch file, whose variables it declares, and of systemd's units.
launch = xml.etree.ElementTree.parse("ros2/joulebus_msgs/launch/bridge.launch.xml")
declared = {one.get("name") for one in launch.iter("arg")}
commands = [("bridge.launch.xml", one.get("cmd")) for one in launch.iter("executable")]
assert len(commands) == 2 and set(re.findall(r"\$\(var (\w+)\)", " ".join(text for _, text in commands))) <= declared
for unit in pathlib.Path("configs/systemd").glob("*.service"):
    lines = (line.removeprefix("ExecStart=/usr/bin/") for line in unit.read_text().splitlines())
    commands += [(unit.name, line) for line in lines if line.startswith("joulebus")]
for name, text in commands:
    program, *words = text.split()
    check(name, [*program.split("-")[1:], *words])
print(f"bridge.launch.xml and systemd's units: {len(commands)} commands exist")

# Grafana: what is mounted exists, and provisioning names what the other services have.
mounts = dict(volume.split(":")[1::-1] for volume in services["grafana"]["volumes"])
here = pathlib.Path("configs/container")
assert all((here / source).exists() for source in mounts.values() if source.startswith(".")), mounts
of = lambda kind: yaml.safe_load((here / mounts["/etc/grafana/provisioning"] / kind / "joulebus.yaml").read_text())
listens = next(word for word in services["prometheus"]["command"] if word.startswith("--web.listen-address="))
assert of("datasources")["datasources"][0]["url"] == "http://" + listens.split("=")[1]
home = services["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
assert home in mounts and home.startswith(of("dashboards")["providers"][0]["options"]["path"] + "/"), home
print("configs/grafana/provisioning: fits the services")
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
