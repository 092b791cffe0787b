#!/usr/bin/env python3
"""Pastes each program of the README and of docs/planning.md, with the [dependencies] above it, into a new project and checks it;
and builds and runs a project that also uses iceoryx2, on its defaults (tests/beside_iceoryx2).

The doctests of `joulebus-examples` compile the same programs, but with more dependencies than these pages name.
"""
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Pages, and how many programs each has at least.
PAGES = {"README.md": 2, "docs/planning.md": 1}
PROGRAM = re.compile(r"```toml\n(\[dependencies\]\n.*?)```\s*```rust,no_run\n(.*?)```", re.DOTALL)


BESIDE = ROOT / "tests/beside_iceoryx2"


def workspace(folder, programs):
    """Writes a project for each (name, dependencies, program)."""
    for member, dependencies, program in programs:
        project = Path(folder, member)
        (project / "src").mkdir(parents=True)
        # The paths are those of a project beside the clone.
        manifest = dependencies.replace("../joulebus/", f"{ROOT}/")
        package = f'[package]\nname = "{member}"\nversion = "0.1.0"\nedition = "2024"\n\n'
        (project / "Cargo.toml").write_text(package + manifest)
        (project / "src" / "main.rs").write_text(program)
    # One workspace, with our profile and versions, so that existing builds are reused.
    ours = (ROOT / "Cargo.toml").read_text()
    profile = "\n".join(re.findall(r'(?m)^\[profile\.dev(?:\.package\."\*")?\]\n(?:\w.*\n)*', ours))
    quoted = ", ".join(f'"{member}"' for member, _, _ in programs)
    Path(folder, "Cargo.toml").write_text(f'[workspace]\nresolver = "3"\nmembers = [{quoted}]\n\n{profile}')
    shutil.copy(ROOT / "Cargo.lock", folder)


def cargo(folder, *arguments):
    command, *rest = arguments
    options = ["--quiet", "--offline", "--target-dir", str(ROOT / "target")]
    return subprocess.run(["cargo", command, *options, *rest], cwd=folder, check=False).returncode


def main() -> int:
    programs = []
    for page, least in PAGES.items():
        found = PROGRAM.findall((ROOT / page).read_text())
        if len(found) < least:
            print(f"{page} has {len(found)} programs with dependencies, at least {least} are expected", file=sys.stderr)
            return 1
        programs += found
    programs = [(f"readme{number}", *found) for number, found in enumerate(programs)]
    with tempfile.TemporaryDirectory() as folder:
        workspace(folder, programs)
        failed = cargo(folder, "check")
    print(f"{len(programs)} programs of {', '.join(PAGES)}, {'some refused' if failed else 'all compile'} in a new project")
    joulebus = ROOT / "target/debug/joulebus"
    if not joulebus.exists():
        failed |= cargo(ROOT, "build", "--locked")
    # A workspace of its own: iceoryx2's features would be those of the programs above, too.
    beside = [("beside", (BESIDE / "dependencies.toml").read_text(), (BESIDE / "main.rs").read_text())]
    with tempfile.TemporaryDirectory() as folder:
        workspace(folder, beside)
        ended = cargo(folder, "run", "--", str(joulebus))
    print(f"a program that also uses iceoryx2 {'fails' if ended else 'works'} with two fleets")
    return failed or ended


if __name__ == "__main__":
    sys.exit(main())
