#!/usr/bin/env python3
"""What the first build, the tests and the gate cost: processor time, wall time, disk.

    tools/gate_cost.py                   # all, some two hours. Leave the machine alone meanwhile
    tools/gate_cost.py --only demo       # demo, tests or gate
    tools/gate_cost.py --table           # what was measured on this commit
    tools/gate_cost.py --try COMMAND…    # one command, to see that the accounting works

Measures in a fresh clone of the commit, in target/gate-cost/clone, whose crates are downloaded
first. It can be interrupted: what was measured on this commit is not measured again. Records and
logs are in target/gate-cost/COMMIT. The table is for docs/decisions/gate.md.

Processor time is that of all processes that a command has waited for. Standard library only.
"""
import argparse
import json
import os
import pathlib
import re
import resource
import shutil
import subprocess
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import figures  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parent.parent
FOLDER = ROOT / "target/gate-cost"
CLONE = FOLDER / "clone"
# No crate of the workspace depends on it. A comment at its end is the change.
LEAF = "crates/gateways/bridge/src/main.rs"
# Steps of a group share what they compiled, so a group begins without it.
GROUPS = {
    "demo": {"demo": ["cargo", "run", "--release", "--locked", "--", "demo", "--duration", "5"]},
    "tests": {
        "compile": ["cargo", "test", "--workspace", "--locked", "--no-run"],
        "run": ["cargo", "test", "--workspace", "--locked"],
    },
    "gate": {"cold": [".ci/run"], "warm": [".ci/run"]},
}
TITLES = {
    "demo": "first `cargo run --release`, with five seconds of the demo",
    "compile": "`cargo test --workspace --no-run`",
    "run": "`cargo test --workspace`, compiled",
    "cold": "`.ci/run`",
    "warm": "`.ci/run` after a change in `joulebus-bridge`",
}
# What the caller's shell may change.
UNSET = re.compile(r"CI|CARGO_TARGET_DIR|CARGO_INCREMENTAL|CARGO_BUILD_.*|RUSTFLAGS|RUST_TEST_THREADS|JOULEBUS_.*")


def measured(command, folder, log=None):
    """Runs a command: its exit code, seconds, and seconds of processors."""
    environment = {name: value for name, value in os.environ.items() if not UNSET.fullmatch(name)}
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    code = subprocess.run(command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=log,
                          stderr=subprocess.STDOUT if log else None).returncode
    wall_s, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return code, wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def git(*arguments, folder=ROOT):
    made = subprocess.run(["git", *arguments], cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
    return made.stdout.strip()


def disk(folder):
    """Bytes of a folder's files on the disk. Hard links count once."""
    return 1024 * int(subprocess.run(["du", "-sk", folder], check=True, stdout=subprocess.PIPE).stdout.split()[0])


def prepare(commit):
    """The clone, as cloned now but for what was compiled."""
    if not CLONE.exists():
        subprocess.run(["git", "clone", "--quiet", "--no-checkout", ROOT, CLONE], check=True)
    shared = ROOT.parent / "shared"
    subprocess.run(["rm", "-rf", FOLDER / "shared"], check=True)
    if shared.is_dir():
        # Recordings that some tests read. A copy: who empties FOLDER keeps the originals.
        subprocess.run(["cp", "-r", "--no-preserve=mode", shared, FOLDER / "shared"], check=True)
    git("fetch", "--quiet", str(ROOT), commit, folder=CLONE)
    git("reset", "--quiet", "--hard", commit, folder=CLONE)
    git("clean", "-fdxq", "-e", "/target", folder=CLONE)


def measure(group, commit, records):
    """Measures the steps of a group that have no record yet."""
    # Names the group and commit whose artefacts lie in the clone's target.
    target, state = CLONE / "target", FOLDER / "state"
    left = [step for step in GROUPS[group] if not (records / f"{step}.json").exists()]
    if not left:
        return
    if not state.exists() or state.read_text() != f"{group} {commit}":
        # All steps, since later ones need what the first compiles.
        left = list(GROUPS[group])
    if left[0] == next(iter(GROUPS[group])):
        shutil.rmtree(target, ignore_errors=True)
    for step in left:
        prepare(commit)
        # Half a warm gate would leave the next one less to do: then the group begins again.
        state.write_text("" if step == "warm" else f"{group} {commit}")
        subprocess.run(["cargo", "fetch", "--locked", "--quiet"], cwd=CLONE, check=True)
        if step == "warm":
            with open(CLONE / LEAF, "r+") as source:
                source.seek(0, os.SEEK_END)
                source.write("// A change.\n")
        command, path = GROUPS[group][step], records / f"{step}.log"
        print(f"== {step}: {' '.join(command)} (log: {path.relative_to(ROOT)})", flush=True)
        with open(path, "w") as log:
            code, wall_s, cpu_s = measured(command, CLONE, log)
        if code != 0:
            print("".join(path.read_text().splitlines(keepends=True)[-20:]))
            sys.exit(f"gate_cost: {step} failed after {wall_s:.0f} s")
        record = {"wall_s": wall_s, "cpu_s": cpu_s, "target_bytes": disk(target)}
        if group == "gate":
            # The gate ends with the time of each step.
            times = path.read_text().rpartition("== passed after")[2]
            record["steps_s"] = {name: int(seconds) for seconds, name in re.findall(r"^ *(\d+) s  (\S+)$", times, re.MULTILINE)}
        part = records / f"{step}.part"
        part.write_text(json.dumps(record) + "\n")
        part.rename(records / f"{step}.json")
        print(f"   {wall_s:.0f} s, {cpu_s:.0f} s of processors", flush=True)
    shutil.rmtree(target, ignore_errors=True)
    state.unlink()


def report(records):
    """The figures of all records that there are."""
    found, figure = [], figures.figure
    known = {step: json.loads(path.read_text()) for step in TITLES if (path := records / f"{step}.json").exists()}
    for step, record in known.items():
        found += [figure("processors", TITLES[step], "min", [record["cpu_s"] / 60]),
                  figure("wall", TITLES[step], "min", [record["wall_s"] / 60])]
        if step in ("demo", "run"):
            found.append(figure("target", TITLES[step], "GB", [record["target_bytes"] / 1e9]))
        found += [figure(f"step_{step}", name, "s", [seconds]) for name, seconds in record.get("steps_s", {}).items()]
    return figures.report("gate", {"fresh_clone": "yes", "changed": LEAF}, found)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=GROUPS)
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--try", dest="command", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    if given.command:
        code, wall_s, cpu_s = measured(given.command, ROOT)
        print(f"exit code {code}, {wall_s:.2f} s, {cpu_s:.2f} s of processors")
        return code
    commit = git("rev-parse", "HEAD")
    records = FOLDER / commit
    records.mkdir(parents=True, exist_ok=True)
    if not given.table:
        if git("status", "--porcelain"):
            print("gate_cost: uncommitted changes are not in the clone", file=sys.stderr)
        for group in [given.only] if given.only else GROUPS:
            measure(group, commit, records)
    print(figures.page(figures.suite(ROOT, [report(records)])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
