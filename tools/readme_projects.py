#!/usr/bin/env python3
"""Builds what users would: programs against the packages that crates.io would get, not against paths of this repository.

Each program of the README and of docs/how-to/ask.md is pasted, with the [dependencies] above it, into a new project and
built, and so are those of docs/how-to/ask-the-worker.md and of the publisher's page. Then they run beside the other languages'
(tools/snippets.py). A project that also uses iceoryx2, on its defaults (tests/beside_iceoryx2), is built and run. Their
dependencies on joulebus are the unpacked files of `cargo package`.

The doctests of `joulebus-examples` compile the same programs, but with more dependencies than these pages name.
"""
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import blocks
import snippets

ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / "target"
# One folder for all runs, so that what was compiled of it is reused.
UNPACKED = TARGET / "unpacked"
# Pages, and how many programs each has at least.
PAGES = {"README.md": 2, "docs/how-to/ask.md": 1}
BESIDE = ROOT / "tests/beside_iceoryx2"
# A dependency on the clone beside a project, as the pages have it.
PATH = re.compile(r'^(joulebus-[a-z-]+) = \{ path = "\.\./joulebus/[a-z/-]+" \}$', re.MULTILINE)


def closure(names):
    """Names and versions of these packages, and of those of joulebus that they need."""
    told = subprocess.run(
        ["cargo", "metadata", "--format-version", "1", "--locked", "--offline", "--no-deps"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )
    packages = {package["name"]: package for package in json.loads(told.stdout)["packages"]}
    found, waiting = {}, list(names)
    while waiting:
        package = packages[waiting.pop()]
        if package["name"] in found:
            continue
        found[package["name"]] = package["version"]
        needed = [of["name"] for of in package["dependencies"] if of["kind"] != "dev"]
        waiting += [name for name in needed if name in packages]
    return found


def unpack(packages):
    """Packs these packages and unpacks them. Files that are the same stay as they are, so that Cargo does not build them again."""
    selected = [argument for name in packages for argument in ("--package", name)]
    options = ["--locked", "--offline", "--allow-dirty", "--no-verify", "--quiet"]
    subprocess.run(["cargo", "package", *selected, *options, "--target-dir", str(TARGET)], cwd=ROOT, check=True)
    for name, version in packages.items():
        kept = set()
        with tarfile.open(TARGET / "package" / f"{name}-{version}.crate") as packed:
            for member in filter(tarfile.TarInfo.isfile, packed.getmembers()):
                content = packed.extractfile(member).read()
                path = UNPACKED / member.name
                kept.add(path)
                if not path.is_file() or path.read_bytes() != content:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(content)
        for path in (UNPACKED / f"{name}-{version}").rglob("*"):
            if path.is_file() and path not in kept:
                path.unlink()


def workspace(folder, programs, packages):
    """Writes a project for each (name, dependencies, program)."""
    for member, dependencies, program in programs:
        project = Path(folder, member)
        (project / "src").mkdir(parents=True)
        manifest = PATH.sub(lambda found: f'{found[1]} = "{packages[found[1]]}"', dependencies)
        package = f'[package]\nname = "{member}"\nversion = "0.1.0"\nedition = "2024"\n\n'
        (project / "Cargo.toml").write_text(package + manifest)
        (project / "src" / "main.rs").write_text(program)
    # One workspace, with our profile and versions, so that existing builds are reused.
    ours = (ROOT / "Cargo.toml").read_text()
    profile = "\n".join(re.findall(r'(?m)^\[profile\.dev(?:\.package\."\*")?\]\n(?:\w.*\n)*', ours))
    quoted = ", ".join(f'"{member}"' for member, _, _ in programs)
    patch = "".join(
        f'{name} = {{ path = "{UNPACKED}/{name}-{version}" }}\n' for name, version in packages.items()
    )
    manifest = f'[workspace]\nresolver = "3"\nmembers = [{quoted}]\n\n[patch.crates-io]\n{patch}\n{profile}'
    Path(folder, "Cargo.toml").write_text(manifest)
    shutil.copy(ROOT / "Cargo.lock", folder)


def cargo(folder, *arguments):
    command, *rest = arguments
    options = ["--quiet", "--offline", "--target-dir", str(TARGET)]
    return subprocess.run(["cargo", command, *options, *rest], cwd=folder, check=False).returncode


def main() -> int:
    programs = []
    for page, least in PAGES.items():
        here = blocks.blocks(page)
        found = [(of.text, program.text) for of, program in zip(here, here[1:])
                 if of.text.startswith("[dependencies]\n") and program.language == "rust,no_run"]
        if len(found) < least:
            print(f"{page} has {len(found)} programs with dependencies, at least {least} are expected", file=sys.stderr)
            return 1
        programs += found
    # Two more, with the dependencies of those that use the same packages.
    others = [
        (programs[0], "crates/publisher/README.md", [("new(0)", "new(51)"), ("new(1)", "new(52)")]),
        (programs[-1], "docs/how-to/ask-the-worker.md", []),
    ]
    for (dependencies, _), page, ids in others:
        text = snippets.block(page, "rust,no_run", "fn main()")
        for own in ids:
            text = snippets.moved(text, *own)
        programs.append((dependencies, text))
    example = snippets.moved((ROOT / "examples/controller.rs").read_text(), "(0..20_u32)", "(20..40_u32)")
    programs.append((programs[0][0], example))
    names = ["controller", "planner", "planning", "two-robots", "queries", "example"]
    programs = [(name, *found) for name, found in zip(names, programs, strict=True)]
    # A workspace of its own: iceoryx2's features would be those of the programs above, too.
    beside = [("beside", (BESIDE / "dependencies.toml").read_text(), (BESIDE / "main.rs").read_text())]
    packages = closure({name for _, dependencies, _ in programs + beside for name in PATH.findall(dependencies)})
    unpack(packages)
    with tempfile.TemporaryDirectory() as folder:
        workspace(folder, programs, packages)
        failed = cargo(folder, "build")
    print(
        f"{len(programs)} programs of {', '.join(PAGES)}, {'some refused' if failed else 'all compile'} in a new project, "
        f"with {len(packages)} packages as crates.io would have them"
    )
    joulebus = TARGET / "debug/joulebus"
    built = [joulebus.exists(), (TARGET / "debug/joulebus-serve").exists(), any(TARGET.glob("debug/deps/libjoulebus_c*.a"))]
    if not all(built):
        selected = [argument for name in ("joulebus", "joulebus-serve", "joulebus-c") for argument in ("--package", name)]
        failed |= cargo(ROOT, "build", "--locked", *selected)
    if not failed:
        failed = snippets.run(TARGET)
    with tempfile.TemporaryDirectory() as folder:
        workspace(folder, beside, packages)
        ended = cargo(folder, "run", "--", str(joulebus))
    print(f"a program that also uses iceoryx2 {'fails' if ended else 'works'} with two fleets")
    return failed or ended


if __name__ == "__main__":
    sys.exit(main())
