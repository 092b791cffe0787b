#!/usr/bin/env python3
"""Pastes each program of the README and of docs/planning.md, with the [dependencies] above it, into a new project and checks it.

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


def main() -> int:
    programs = []
    for page, least in PAGES.items():
        found = PROGRAM.findall((ROOT / page).read_text())
        if len(found) < least:
            print(f"{page} has {len(found)} programs with dependencies, at least {least} are expected", file=sys.stderr)
            return 1
        programs += found
    with tempfile.TemporaryDirectory() as folder:
        members = [f"readme{number}" for number in range(len(programs))]
        for member, (dependencies, program) in zip(members, programs):
            project = Path(folder, member)
            (project / "src").mkdir(parents=True)
            # The pages' paths are those of a project beside the clone.
            manifest = dependencies.replace("../joulebus/", f"{ROOT}/")
            package = f'[package]\nname = "{member}"\nversion = "0.1.0"\nedition = "2024"\n\n'
            (project / "Cargo.toml").write_text(package + manifest)
            (project / "src" / "main.rs").write_text(program)
        # One workspace, with our profile and versions, so that existing builds are reused.
        ours = (ROOT / "Cargo.toml").read_text()
        profile = "\n".join(re.findall(r'(?m)^\[profile\.dev(?:\.package\."\*")?\]\n(?:\w.*\n)*', ours))
        quoted = ", ".join(f'"{member}"' for member in members)
        Path(folder, "Cargo.toml").write_text(f'[workspace]\nresolver = "3"\nmembers = [{quoted}]\n\n{profile}')
        shutil.copy(ROOT / "Cargo.lock", folder)
        check = ["cargo", "check", "--quiet", "--offline", "--target-dir", str(ROOT / "target")]
        failed = subprocess.run(check, cwd=folder, check=False).returncode
    print(f"{len(programs)} programs of {', '.join(PAGES)}, {'some refused' if failed else 'all compile'} in a new project")
    return failed


if __name__ == "__main__":
    sys.exit(main())
