#!/usr/bin/env python3
"""Measures energy over a horizon, and prints the tables of docs/measured.

    python3 tools/energy_tables.py            # some 10 minutes after the build
    python3 tools/energy_tables.py --from LOG # the tables of an earlier run's output

Simulates the recordings with seed 1, runs the example `energy`, and prints the tables of energy.md,
outlooks.md and mission.md. The rows of robots need ../shared/data. Networks have seed 1.
Standard library only.
"""
import collections
import pathlib
import re
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from figures import table  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parent.parent
SEED = "1"
FORECASTS = ["energy model", "last reading", "mean 1 s", "mean 5 s", "mean of all", "AR(5)", "network", "outlook"]
PLAIN = FORECASTS[1:5]
SETS = {"robotino": "Robotino", "borealtc_husky": "Husky", "ase_rover": "rover"}
WORDS = re.compile(r"^(one_surface_type_|energy_data_)|_(surface_exp|surface|exp|robot)$")
# Fewer forecasts make no row.
MIN_FORECASTS = 30


def run(*command):
    print("==", *command, file=sys.stderr)
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def measured():
    with tempfile.TemporaryDirectory() as folder:
        run("cargo", "run", "--locked", "-p", "joulebus-lab", "--", "data", "simulate", folder, "--seed", SEED)
        return run("cargo", "run", "--locked", "-p", "joulebus-eval", "--example", "energy", "--", "--quick", folder)


def parsed(said):
    """Rows of the output: set, group (empty for halves), and the cells by the names of their columns."""
    found, head, title = [], None, None
    for line in said.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if match := re.fullmatch(r"(\w+), (?:each half by the other|(.+) by all others)", line):
            title = match[1], match[2] or ""
        elif line.startswith("| horizon s"):
            head = cells
        elif line.startswith("|") and not line.startswith("|-"):
            cells = dict(zip(head, cells))
            if "forecasts" in cells:
                found.append((*title, cells))
            else:
                found[-1][2].setdefault("halves", []).append(cells)
    return [row for row in found if int(row[2]["forecasts"]) >= MIN_FORECASTS]


def named(group):
    while (shorter := WORDS.sub("", group)) != group:
        group = shorter
    return group.replace("_", " ")


def label(row):
    return named(row[1]) if row[1] else SETS.get(row[0], row[0])


def short(value):
    return value.removeprefix("0") if value.startswith("0.") else value


def errors(rows):
    """A table of energy.md: the lowest error of each row is bold."""
    head = ["recordings", "horizon s", *FORECASTS, "coverage %", "width", "narrowest", "outlook's coverage %", "its score"]

    def line(row):
        cells = row[2]
        least = min(cells[name] for name in FORECASTS if cells[name] != "–")
        error = lambda name: f"**{short(cells[name])}**" if cells[name] == least else short(cells[name])
        others = [cells["coverage %"], short(cells["width"]), short(cells["narrowest"]), cells["outlook's coverage %"], short(cells["its score"])]
        return [label(row), cells["horizon s"], *map(error, FORECASTS), *others]

    return table(head, map(line, rows))


def outlooks(rows):
    """The tables of outlooks.md, and how many rows keep the goal."""
    by = collections.defaultdict(list)
    for row in rows:
        by[float(row[2]["horizon s"])].append(row)
    excess = lambda row: 100 * (float(row[2]["outlook"]) / min(float(row[2][name]) for name in PLAIN) - 1)
    worst = lambda rows: sorted((row for row in rows if excess(row) > 5), key=excess, reverse=True)
    text = lambda rows: ", ".join(f"{label(row)}: {excess(row):.0f}" for row in rows) or "none"
    lines = [[f"{horizon:g}", str(len(its)), text(worst(its))] for horizon, its in sorted(by.items())]
    first = table(["horizon s", "rows", "error more than 5 % above the best plain forecast, by %"], lines)
    lines, held = [], []
    for horizon, its in sorted(by.items()):
        of = [(float(row[2]["outlook's coverage %"].replace("–", "nan")), label(row)) for row in its]
        of = [one for one in of if one[0] == one[0]]
        some = lambda chosen: ", ".join(f"{name}: {value:g}" for value, name in sorted(chosen)) or "none"
        below, above = [one for one in of if one[0] < 85], [one for one in of if one[0] > 95]
        lines.append([f"{horizon:g}", some(below), some(above)] if of else [f"{horizon:g}", "no bounds", "no bounds"])
        if horizon in (3, 10):
            held.append(f"{len(of) - len(below) - len(above)} of {len(of)} at {horizon:g} s")
    second = table(["horizon s", "coverage of 90 % below 85 %", "above 95 %"], lines)
    kept = sum(excess(row) <= 5 for row in rows)
    return (f"The error is at most 5 % above the best plain forecast in {kept} of {len(rows)} rows. "
            f"Coverage is 85 to 95 % in {' and '.join(held)}.\n\n{first}\n\n{second}")


def verdicts(rows):
    by = collections.defaultdict(list)
    for row in rows:
        if float(row[2]["horizon s"]) <= 10:
            by[label(row)].append(row[2]["right yes %"])
    return table(["recordings", "right, % (1 · 3 · 10 s)"], ([name, " · ".join(its)] for name, its in by.items()))


def main():
    match sys.argv[1:]:
        case []:
            said = measured()
        case ["--from", log]:
            said = pathlib.Path(log).read_text()
        case _:
            sys.exit(__doc__)
    rows = parsed(said)
    halves, groups = [row for row in rows if not row[1]], [row for row in rows if row[1]]
    tens = [row for row in groups if float(row[2]["horizon s"]) == 10]
    tables = {
        "energy.md, each half by the other": errors(halves),
        "energy.md, each group by all others": errors(tens),
        "outlooks.md": outlooks(rows),
        "mission.md": verdicts([row for row in groups if row[0] != "simulated"]),
    }
    print("\n\n".join(f"## {page}\n\n{text}" for page, text in tables.items()))


if __name__ == "__main__":
    main()
