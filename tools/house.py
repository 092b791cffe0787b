#!/usr/bin/env python3
"""The tables of docs/measured/house.md, counted from commits. Compiles nothing.

    tools/house.py HEAD                    # one commit
    tools/house.py df6ba14 HEAD            # two, side by side
    tools/house.py --write df6ba14 HEAD    # writes the page
    tools/house.py --timings target/cargo-timings/cargo-timing.html HEAD

Unpacks each commit and asks Cargo there. --timings adds unit-seconds by crate, of the page of
`cargo build --timings`: two pages for two commits. Without it the page keeps those that it has.
Standard library only.
"""
import argparse
import collections
import io
import json
import pathlib
import re
import subprocess
import tarfile
import tempfile
import textwrap

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/measured/house.md"
SDK = ["consumer", "plan", "planner", "publisher"]

# What frames and rows of each channel are called. `State` and `Query` alone have other meanings.
CHANNELS = {
    "samples": "Sample Samples SampleHeader",
    "forecasts": "Forecast Forecasts ForecastHeader",
    "diagnostics": "Diagnostic Diagnostics DiagnosticHeader",
    "budgets": "Budget Budgets BudgetHeader",
    "plan states": "PlanState PlanStates PlanStateHeader",
    "outlooks": "Outlook Outlooks OutlookHeader",
    "ticks": "TakenFrame Ticks TickHeader",
    "state": "StateHeader",
    "queries": "QueryRecord QueryCounts Queries QueriesHeader",
    "acknowledgements": "Acknowledgement Acknowledgements AcknowledgementHeader",
}
# The review of df6ba14 counted the files that name all of these.
FOUR = ["forecasts", "diagnostics", "budgets", "plan_states"]


def output(*command, folder=ROOT):
    return subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE).stdout


def is_test(path):
    """Of the part of a path within its package."""
    return bool({"tests", "benches"} & set(path.parts)) or path.name == "tests.rs"


def split(lines):
    """The lines of a source, and those of its `#[cfg(test)]` modules."""
    written, tests, within = [], [], False
    for at, line in enumerate(lines):
        if line.startswith("#[cfg(test)]") and any(re.match(r"mod \w+ \{", after) for after in lines[at + 1:at + 3]):
            within = True
        (tests if within else written).append(line)
        within = within and line != "}"
    return written, tests


class Crate:
    def __init__(self):
        self.lines = collections.Counter()
        self.binaries, self.folder, self.published, self.has_program = 0, None, False, False
        self.own = self.others = None
        self.has_iceoryx2 = False


class House:
    """What is counted of one commit."""

    def __init__(self, commit):
        self.commit = output("git", "rev-parse", "--short=8", f"{commit}^{{commit}}").decode().strip()
        self.date = output("git", "show", "-s", "--format=%cs", commit).decode().strip()
        self.crates, self.named, self.four = collections.defaultdict(Crate), collections.Counter(), 0
        with tempfile.TemporaryDirectory(prefix="joulebus-house-") as folder:
            root = pathlib.Path(folder).resolve()
            with tarfile.open(fileobj=io.BytesIO(output("git", "archive", commit))) as archive:
                archive.extractall(root)
            self.packages(root)
            self.sources(root)
        assert self.sum("source") > 50_000, "sources were not found"

    def packages(self, root):
        found = json.loads(output("cargo", "metadata", "--locked", "--no-deps", "--format-version=1", folder=root))
        for package in found["packages"]:
            crate = self.crates[package["name"].removeprefix("joulebus-")]
            crate.folder = pathlib.Path(package["manifest_path"]).parent
            kinds = [kind for target in package["targets"] for kind in target["kind"]]
            crate.binaries, crate.has_program = kinds.count("test"), "bin" in kinds
            crate.published = package["publish"] is None
            if crate.published:
                # As the test of third_party.txt.
                tree = output("cargo", "tree", "--locked", "--package", package["name"], "--edges=normal,build",
                              "--target=x86_64-unknown-linux-gnu", "--prefix=none", folder=root).decode()
                lines = {line.removesuffix(" (*)") for line in tree.splitlines()}
                # A package of the workspace is followed by its folder.
                own = {line for line in lines if "(/" in line}
                crate.own, crate.others = len(own) - 1, len(lines - own)
                crate.has_iceoryx2 = any(line.startswith("iceoryx2 ") for line in lines)

    def sources(self, root):
        folders = {crate.folder: name for name, crate in self.crates.items()}
        for path in root.rglob("*.rs"):
            folder = next((parent for parent in path.parents if parent in folders), None)
            name = folders[folder] if folder else path.relative_to(root).parts[0]
            within = path.relative_to(folder or root)
            lines = path.read_text().splitlines()
            written, tests = ([], lines) if is_test(within) else split(lines)
            counts = self.crates[name].lines
            counts["tests"] += len(tests)
            counts["source"] += len(written)
            code = []
            for line in map(str.strip, written):
                if line.startswith(("///", "//!")):
                    counts["documentation"] += 1
                elif line.startswith("//"):
                    counts["comments"] += 1
                elif line:
                    code.append(line)
                else:
                    counts["blank"] += 1
            if within.parts[:1] == ("src",) and self.crates[name].published:
                self.channels(" ".join(code))

    def channels(self, code):
        words = set(re.findall(r"\w+", code))
        self.named.update(channel for channel, types in CHANNELS.items() if words & set(types.split()))
        flat = code.lower().replace("_", "")
        self.four += all(name.replace("_", "").removesuffix("s") in flat for name in FOUR)

    def sum(self, key):
        return sum(crate.lines[key] for crate in self.crates.values())

    def share(self, key):
        return f"{100 * self.sum(key) / (self.sum('source') - self.sum('blank')):.1f} %"


def wrapped(text):
    """The paragraphs, in lines of 100 columns."""
    return "\n".join(line if line.startswith(("|", "#", "`")) else textwrap.fill(line, 100, break_on_hyphens=False)
                     for line in text.splitlines())


def table(houses, head, rows):
    """A table. A cell of a row has one value for each commit."""
    titles = [head[0], *(f"{title}, {house.commit}" for title in head[1:] for house in houses)]
    lines = [titles, ["---"] * len(titles)]
    for name, *cells in rows:
        shown = [f"{cell:,}" if isinstance(cell, int) else "–" if cell is None else cell for one in cells for cell in one]
        lines.append([name, *shown])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def of_crates(houses, names, *values):
    """Rows: a name and what each function says of its crate in each commit."""
    each = lambda name, value: [value(house.crates[name]) if name in house.crates else None for house in houses]
    return [(name, *(each(name, value) for value in values)) for name in names]


def unit_seconds(file):
    """Seconds of all units of each crate in a page of `cargo build --timings`."""
    found = collections.Counter()
    data = re.search(r"UNIT_DATA = (\[.*?\]);?\s*(?:const|let|var)", pathlib.Path(file).read_text(), re.DOTALL)
    for unit in json.loads(data[1]):
        found[unit["name"]] += unit["duration"]
    return found


def timings(files, houses):
    all_of = list(map(unit_seconds, files))
    longest = sorted(set().union(*all_of), key=lambda name: -max(of[name] for of in all_of))
    rows = [(name, [f"{of[name]:.1f}" if name in of else None for of in all_of]) for name in longest[:25]]
    own = lambda of: sum(seconds for name, seconds in of.items() if name.startswith("joulebus"))
    rows += [("*joulebus*", [f"{own(of):.0f}" for of in all_of]), ("*all*", [f"{sum(of.values()):.0f}" for of in all_of])]
    return ("## Unit-seconds\nSeconds that Cargo's units took in `cargo build --release --timings`, several at a "
            "time. The 25 longest crates, and sums.\n\n" + table(houses, ["crate", "s"], rows))


def sections(houses):
    has = lambda name, of: any(of(house.crates[name]) for house in houses if name in house.crates)
    names = sorted(set().union(*(house.crates for house in houses)))
    published = [name for name in names if has(name, lambda crate: crate.published)]
    programs = [name for name in published if name in SDK or has(name, lambda crate: crate.has_program)]
    measured = [name for name in names if has(name, lambda crate: crate.lines)]
    with_tests = [name for name in names if has(name, lambda crate: crate.binaries > 1)]
    totals = [("*files that name forecasts, diagnostics, budgets and plan states*", [house.four for house in houses])]
    lines = lambda key: lambda crate: crate.lines[key]
    yield ("## Files that name a channel\nSource files of published crates whose code names a type of the channel: its "
           "rows, its header, or the channel itself. Comments and tests do not count.\n\n"
           + table(houses, ["channel", "files"], [
               *((channel, [house.named[channel] for house in houses]) for channel in CHANNELS), *totals]))
    yield ("## What a crate compiles\nPackages that each published crate depends on, by normal and build "
           "dependencies on x86-64. *iceoryx2* says whether shared memory is among them. The [rules between "
           "crates](../decisions/edges.md) hold that for the crates of the drawing.\n\n"
           + table(houses, ["crate", "of joulebus", "iceoryx2"], of_crates(
               houses, published, lambda crate: crate.own, lambda crate: "yes" if crate.has_iceoryx2 else "–")))
    yield ("## Third-party crates\nPackages of others in each program and each library of the SDK. A test holds "
           "these numbers (`tests/tests/repository/dependency_rules/third_party.txt`).\n\n"
           + table(houses, ["program or library", "packages"], of_crates(houses, programs, lambda crate: crate.others)))
    yield ("## Integration binaries\nTest programs that Cargo links beside those of libraries and programs. "
           "Crates with more than one are named. [The gate](../decisions/gate.md) says what needs a program of its "
           "own.\n\n" + table(houses, ["crate", "test programs"], [
               *of_crates(houses, with_tests, lambda crate: crate.binaries),
               ("*all*", [sum(crate.binaries for crate in house.crates.values()) for house in houses])]))
    yield ("## Lines of Rust\nLines of all files, blank ones among them. *Tests* are folders `tests` and `benches`, "
           "files `tests.rs`, and `#[cfg(test)]` modules. A dash means that there was no such crate.\n\n"
           + table(houses, ["crate", "sources", "tests"], [
               *of_crates(houses, measured, lines("source"), lines("tests")),
               ("*all*", [house.sum("source") for house in houses], [house.sum("tests") for house in houses]),
               ("*sources and tests*", [house.sum("source") + house.sum("tests") for house in houses], [""] * len(houses))]))
    yield ("## Comments\nShares of the lines of sources that are not blank. Imports form no circle: "
           "`files_have_no_import_cycles` holds that.\n\n"
           + table(houses, ["lines", "share"], [
               ("documentation (`///`, `//!`)", [house.share("documentation") for house in houses]),
               ("comments (`//`)", [house.share("comments") for house in houses])]))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commits", nargs="+", metavar="COMMIT")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)}")
    parser.add_argument("--timings", action="append", default=[], metavar="FILE", help="one for each commit")
    given = parser.parse_args()
    if len(given.commits) > 2 or len(given.timings) not in (0, len(given.commits)):
        parser.error("one or two commits, and as many --timings as commits or none")
    houses = [House(commit) for commit in given.commits]
    parts = list(sections(houses))
    kept = PAGE.read_text().partition("\n## Unit-seconds\n") if given.write and PAGE.exists() else ("", "", "")
    if given.timings:
        parts.append(timings(given.timings, houses))
    elif kept[1]:
        parts.append((kept[1] + kept[2]).strip())
    if not given.write:
        return print("\n\n".join(parts))
    told = " and ".join(f"{house.commit} ({house.date})" for house in houses)
    head = (f"# Sizes of the repository\n\n<!-- generated by tools/house.py -->\n\nThis page counts files, "
            f"dependencies and lines at {told}. The [rooms](../decisions/rooms.md) were built between them. Nothing "
            f"is compiled for it.\n\n```sh\ntools/house.py --write {' '.join(given.commits)}\n```")
    PAGE.write_text("\n\n".join(wrapped(part) for part in [head, *parts]) + "\n")


if __name__ == "__main__":
    main()
