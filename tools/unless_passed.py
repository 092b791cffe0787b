#!/usr/bin/env python3
"""Runs a command unless it has passed before on the same inputs.

    tools/unless_passed.py NAME [--package P]... [--path FOLDER_OR_FILE]... -- COMMAND [ARGUMENT]...

The inputs are: the named paths; the folders of the packages, and of all packages of the workspace
that these depend on, for tests as well; Cargo.lock, the root manifest, the command, the compiler,
and the variables CI and JOULEBUS_*. A digest of them is kept in target/passed/NAME when the command
ends with 0 and says of nothing that it was "skipped:". Ignored files do not count, uncommitted ones
do. A clean clone has no digest, so it runs everything. JOULEBUS_AGAIN=1 runs the command in any case.
"""
import argparse
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Read by every build: crates embed files of configs. This file is among them: changed rules change
# every digest.
ALWAYS = ["Cargo.lock", "Cargo.toml", ".cargo", "configs", "tools/unless_passed.py"]


def output(*command: str) -> bytes:
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout


def closure(packages: list[str]) -> list[str]:
    """Folders of the packages and of what they depend on within the workspace."""
    metadata = json.loads(output("cargo", "metadata", "--format-version", "1", "--no-deps", "--offline"))
    known = {package["name"]: package for package in metadata["packages"]}
    reached: set[str] = set()
    waiting = list(packages)
    while waiting:
        name = waiting.pop()
        if name in reached:
            continue
        if name not in known:
            sys.exit(f"unless_passed: no package {name} in the workspace")
        reached.add(name)
        waiting += [needed["name"] for needed in known[name]["dependencies"] if needed.get("path")]
    folders = {Path(known[name]["manifest_path"]).parent.relative_to(ROOT).as_posix() for name in reached}
    # Sources that are compiled a second time have their manifest elsewhere.
    for name in reached:
        for target in known[name]["targets"]:
            folders.add(Path(target["src_path"]).resolve().parent.relative_to(ROOT).as_posix())
    return sorted(folders)


def digest(paths: list[str], command: list[str]) -> str:
    listed = output("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *paths)
    state = hashlib.sha256()
    for path in sorted({path for path in listed.decode().split("\0") if path}):
        file = ROOT / path
        if file.is_symlink():
            contents = os.readlink(file).encode()
        elif file.is_file():
            contents = file.read_bytes()
        else:
            # Deleted and not committed yet.
            continue
        state.update(f"{path}\0{hashlib.sha256(contents).hexdigest()}\0".encode())
    state.update("\0".join(command).encode())
    state.update(output("rustc", "-vV"))
    for name in sorted(os.environ):
        if name == "CI" or name.startswith("JOULEBUS_") and name != "JOULEBUS_AGAIN":
            state.update(f"\0{name}={os.environ[name]}".encode())
    return state.hexdigest()


def run(command: list[str]) -> tuple[int, bool]:
    """The exit code, and whether the command said that it skipped something."""
    skipped = False
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        for line in process.stdout:
            sys.stdout.buffer.write(line)
            sys.stdout.buffer.flush()
            skipped |= b"skipped:" in line.lower()
    return process.returncode, skipped


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name")
    parser.add_argument("--package", action="append", default=[])
    parser.add_argument("--path", action="append", default=[])
    ours, command = sys.argv[1:], []
    if "--" in ours:
        mark = ours.index("--")
        ours, command = ours[:mark], ours[mark + 1:]
    arguments = parser.parse_args(ours)
    if not command:
        parser.error("no command after --")
    missing = [path for path in arguments.path if not (ROOT / path).exists()]
    if missing:
        parser.error(f"no such path: {', '.join(missing)}")
    found = digest(ALWAYS + arguments.path + closure(arguments.package), command)
    kept = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"), "passed", arguments.name)
    again = os.environ.get("JOULEBUS_AGAIN") == "1"
    if not again and kept.is_file() and kept.read_text() == found:
        print(f"passed before on the same inputs (JOULEBUS_AGAIN=1 repeats it; {kept})")
        return 0
    kept.unlink(missing_ok=True)
    code, skipped = run(command)
    # Inputs that changed meanwhile were not what passed.
    if code == 0 and not skipped and digest(ALWAYS + arguments.path + closure(arguments.package), command) == found:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(found)
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main())
