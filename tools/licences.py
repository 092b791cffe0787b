#!/usr/bin/env python3
"""Prints the licences of the libraries that programs of the workspace contain: `tools/licences.py PACKAGE…`

Texts that several libraries share are printed once. Ends with 1 if a library states no licence.
"""
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# C libraries lie in a folder of the crate that compiles them.
TEXTS = ["", "*/", "*/*/"]
NAME = re.compile(r"(?i)^(licen[cs]e|copying|notice|unlicense|.*[-.]licen[cs]e)([-._].*)?$")
# Folders of a crate that no program contains.
LEFT_OUT = re.compile(r"/(tests?|examples?|benches|fuzz|doc|docs|\.github)/")


def contained(metadata: dict, programs: list[str]) -> list[dict]:
    """The packages that those programs link, without those of the workspace."""
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    todo = [key for key, package in packages.items() if package["name"] in programs and package["source"] is None]
    missing = set(programs) - {packages[key]["name"] for key in todo}
    if missing:
        sys.exit(f"licences.py: the workspace has no {sorted(missing)}")
    found = set(todo)
    while todo:
        for dependency in nodes[todo.pop()]["deps"]:
            is_linked = any(kind["kind"] is None for kind in dependency["dep_kinds"])
            if is_linked and dependency["pkg"] not in found:
                found.add(dependency["pkg"])
                todo.append(dependency["pkg"])
    linked = [packages[key] for key in found if packages[key]["source"] is not None]
    # Macros run in the compiler.
    linked = [package for package in linked if not any("proc-macro" in target["kind"] for target in package["targets"])]
    return sorted(linked, key=lambda package: (package["name"], package["version"]))


def texts_of(folder: Path) -> list[str]:
    paths = [path for depth in TEXTS for path in sorted(folder.glob(f"{depth}*"))]
    paths = [path for path in paths if NAME.match(path.name) and not LEFT_OUT.search(str(path.relative_to(folder.parent)))]
    paths = [path for path in paths if path.is_file() and path.suffix not in (".rs", ".toml", ".html", ".json", ".py")]
    return [text for path in paths if (text := path.read_text(errors="replace").strip())]


def main() -> int:
    version = subprocess.run(["rustc", "-vV"], check=True, stdout=subprocess.PIPE, text=True).stdout
    host = re.search(r"(?m)^host: (.*)$", version)[1]
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", host]
    metadata = json.loads(subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout)
    libraries = [
        (f"{package['name']} {package['version']}", package["license"], package["repository"], Path(package["manifest_path"]).parent)
        for package in contained(metadata, sys.argv[1:])
    ]
    vendored = ROOT / "crates/gateways/serve/page/vendor"
    libraries.append(("uPlot (in the page of joulebus-serve and in reports)", "MIT", "https://github.com/leeoniya/uPlot", vendored))
    numbers: dict[str, int] = {}
    print("Libraries that the programs of joulebus contain. The numbers are those of the texts below.\n")
    unknown = []
    for name, licence, repository, folder in libraries:
        texts = [numbers.setdefault(text, len(numbers) + 1) for text in texts_of(folder)]
        if not licence and not texts:
            unknown.append(name)
        shown = ", ".join(map(str, sorted(set(texts)))) or "the crate has no text"
        print(f"{name}: {licence or 'see the text'}; {repository or 'crates.io'} [{shown}]")
    for text, number in numbers.items():
        print(f"\n{'=' * 30} {number} {'=' * 30}\n{text}")
    if unknown:
        print(f"licences.py: no licence of {unknown}", file=sys.stderr)
    return 1 if unknown else 0


if __name__ == "__main__":
    sys.exit(main())
