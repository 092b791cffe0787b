#!/usr/bin/env python3
"""Which crates a build compiles again although `cargo run --release` has compiled them: with other features, or on other crates.

    tools/shared_builds.py                # each program, and the workspace
    tools/shared_builds.py joulebus-lab   # with the crates at which the difference begins

Reads Cargo's unit graphs. Compiles nothing. crates/host/program/Cargo.toml has the features that all programs share.
"""

import hashlib
import json
import os
import subprocess
import sys

PROGRAMS = ["lab", "serve", "bridge", "link", "bench", "rosbag"]


def graph(*selection):
    command = ["cargo", "build", "--release", "--unit-graph", "-Z", "unstable-options", "--locked", *selection]
    # The unit graph is an unstable option of Cargo. Nothing is compiled with it.
    made = subprocess.run(command, env={**os.environ, "RUSTC_BOOTSTRAP": "1"}, check=True, stdout=subprocess.PIPE)
    return json.loads(made.stdout)["units"]


def digests(units):
    """A digest of each unit with all that it depends on."""
    known = {}

    def digest(place):
        if place not in known:
            unit = units[place]
            of = [unit[key] for key in ("pkg_id", "target", "profile", "platform", "mode", "features")]
            of.append(sorted((used["extern_crate_name"], digest(used["index"])) for used in unit["dependencies"]))
            known[place] = hashlib.sha256(json.dumps(of, sort_keys=True).encode()).hexdigest()
        return known[place]

    return [digest(place) for place in range(len(units))]


def name(unit):
    return unit["pkg_id"], unit["target"]["name"], unit["mode"]


def main():
    first = graph()
    compiled, names = set(digests(first)), {name(unit) for unit in first}
    for package in sys.argv[1:] or [f"joulebus-{program}" for program in PROGRAMS] + ["--workspace"]:
        units = graph(package) if package == "--workspace" else graph("--package", package)
        of = digests(units)
        again = [(unit, digest) for unit, digest in zip(units, of) if digest not in compiled and name(unit) in names]
        print(f"{package}: {len(units)} units, {len(again)} of the first command's again")
        if sys.argv[1:]:
            for unit, _ in again:
                if all(of[used["index"]] in compiled for used in unit["dependencies"]):
                    print(f"    {unit['pkg_id'].rsplit('/', 1)[-1]} {unit['mode']}: {' '.join(unit['features'])}")


main()
