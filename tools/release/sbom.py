#!/usr/bin/env python3
"""The libraries in programs of the workspace as a bill of materials (CycloneDX 1.6, JSON): `sbom.py PACKAGE…`

`sbom.py --validate FILE` checks one against CycloneDX's schema. That needs cyclonedx-python-lib. The same sources give the same
bytes, but for SOURCE_DATE_EPOCH.
"""
import json
import os
import subprocess
import sys
import tomllib
import uuid
from datetime import datetime, timezone
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))


def purl(package: dict) -> str:
    return f"pkg:cargo/{package['name']}@{package['version']}"


def component(package: dict, checksums: dict[tuple[str, str], str]) -> dict:
    found = {
        "type": "library",
        "bom-ref": purl(package),
        "name": package["name"],
        "version": package["version"],
        "scope": "required",
        "purl": purl(package),
    }
    if package["license"]:
        # Cargo's old form of "or".
        found["licenses"] = [{"expression": package["license"].replace("/", " OR ")}]
    if checksum := checksums.get((package["name"], package["version"])):
        found["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    if package["repository"]:
        found["externalReferences"] = [{"type": "vcs", "url": package["repository"]}]
    return found


def bill(programs: list[str]) -> dict:
    from licences import contained

    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform"]
    host = subprocess.run(["rustc", "--print", "host-tuple"], check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    metadata = json.loads(subprocess.run([*command, host], cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout)
    locked = tomllib.loads((ROOT / "Cargo.lock").read_text())["package"]
    checksums = {(one["name"], one["version"]): one["checksum"] for one in locked if "checksum" in one}
    packages = {package["id"]: package for package in metadata["packages"]}
    libraries = contained(metadata, programs)
    kept = {package["id"] for package in libraries}
    own = {key for key, package in packages.items() if package["source"] is None}
    nodes = {node["id"]: {one["pkg"] for one in node["deps"]} for node in metadata["resolve"]["nodes"]}

    # Those of the programs: of all crates of the workspace that they are made of.
    reached, waiting = set(), [key for key in own if packages[key]["name"] in programs]
    while waiting:
        key = waiting.pop()
        if key not in reached:
            reached.add(key)
            waiting += nodes[key] & own
    needed = {key for crate in reached for key in nodes[crate]} & kept
    version = next(packages[key]["version"] for key in own if packages[key]["name"] == programs[0])
    main = f"pkg:generic/joulebus@{version}"
    depends = [{"ref": main, "dependsOn": sorted(purl(packages[key]) for key in needed)}]
    depends += [{"ref": purl(package), "dependsOn": sorted(purl(packages[key]) for key in nodes[package["id"]] & kept)} for package in libraries]
    made = datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH", "0")), timezone.utc)
    listed = [component(package, checksums) for package in libraries]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": uuid.uuid5(uuid.NAMESPACE_URL, main + json.dumps(listed)).urn,
        "version": 1,
        "metadata": {
            "timestamp": made.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "component": {
                "type": "application",
                "bom-ref": main,
                "name": "joulebus",
                "version": version,
                "purl": main,
                "licenses": [{"expression": "MIT OR Apache-2.0"}],
                "properties": [{"name": "joulebus:program", "value": program} for program in programs],
            },
        },
        "components": listed,
        "dependencies": depends,
    }


def validate(path: str) -> None:
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    text = Path(path).read_text()
    error = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if error is not None:
        sys.exit(f"{path}: {error}")
    found = json.loads(text)
    print(f"{path}: valid, {len(found['components'])} libraries", file=sys.stderr)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--validate"]:
        validate(sys.argv[2])
    elif len(sys.argv) > 1:
        json.dump(bill(sys.argv[1:]), sys.stdout, indent=1, sort_keys=True)
        print()
    else:
        sys.exit(__doc__)
