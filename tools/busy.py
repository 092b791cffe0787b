#!/usr/bin/env python3
"""Runs the tests on a busy machine: beside eight busy loops, on any number of cores.

    tools/busy.py 3                          # the whole workspace, three times
    tools/busy.py 20 --processes             # the programs whose tests start processes
    tools/busy.py 5 -p joulebus-tests --test system floods

Compiles first. Then it runs each test program RUNS times, some of them side by side, and never one
beside itself. It prints a line for each program that failed, and at the end a table of the runs.
Ends with 1 if anything failed.

After an interruption it continues: a program that ended, passed or failed, does not run again for
the same sources, arguments and variables of tests. Logs and records are in target/busy/KEY. Remove
that folder to begin again.
"""

import argparse
import concurrent.futures
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Packages with tests that start processes of the product.
PROCESSES = ["joulebus", "joulebus-bus", "joulebus-plan-server", "joulebus-link", "joulebus-tests"]
LOOP = "import os, sys\nwhile os.getppid() == int(sys.argv[1]):\n    for _ in range(1000000):\n        pass"


def output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def key_of(arguments: list[str]) -> str:
    """What a result depends on: sources, arguments, and what tests read from the environment."""
    digest = hashlib.sha256((output("git", "rev-parse", "HEAD") + output("git", "diff", "HEAD")).encode())
    for path in output("git", "ls-files", "--others", "--exclude-standard", "-z").split("\0")[:-1]:
        digest.update(path.encode() + (ROOT / path).read_bytes())
    read = re.compile("CI$|RUST_TEST_THREADS$|JOULEBUS_|PROPTEST_")
    variables = sorted(f"{name}={value}" for name, value in os.environ.items() if read.match(name))
    digest.update("\n".join(arguments + variables).encode())
    return digest.hexdigest()[:16]


def note(folder: Path, command: list[str]) -> None:
    """Writes down the test program that Cargo would have run."""
    program = {"command": command, "folder": os.getcwd(), "variables": dict(os.environ)}
    name = re.sub("-[0-9a-f]{16}$", "", Path(command[0]).name)
    (folder / f"{name}.{os.getpid()}.json").write_text(json.dumps(program))


def programs_of(records: Path, arguments: list[str]) -> list[tuple[str, dict]]:
    """The test programs as Cargo would run them, by a name each."""
    folder = records / "programs"
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    target = re.search("host: (.*)", output("rustc", "-vV"))[1]
    variable = f"CARGO_TARGET_{target.upper().replace('-', '_')}_RUNNER"
    runner = f"{sys.executable} {Path(__file__).resolve()}"
    subprocess.run(["cargo", "test", "--locked", "--no-run", *arguments], cwd=ROOT, check=True)
    command = ["cargo", "test", "--locked", "--quiet", *arguments]
    subprocess.run(command, cwd=ROOT, check=True, env=os.environ | {variable: f"{runner} --note {folder}", "RUSTDOC": "true"})
    found = {}
    for path in sorted(folder.iterdir()):
        program = json.loads(path.read_text())
        for changed in [variable, "RUSTDOC"]:
            program["variables"].pop(changed, None)
        package = program["variables"]["CARGO_PKG_NAME"].removeprefix("joulebus-")
        found[f"{package}.{path.name.split('.')[0]}"] = program
    # The blocks of the documentation are compiled as they run, so by Cargo. `cargo test --doc`
    # would run those of packages, too, that have none.
    variables = dict(os.environ) | {variable: f"{runner} --blocks"}
    found["documentation"] = {"command": command, "folder": str(ROOT), "variables": variables}
    return list(found.items())


# Process groups of the programs that run, and whether they have to end.
RUNNING: set[int] = set()
STOPPED = threading.Event()


def stop() -> None:
    """Ends the programs that run. They leave no record."""
    STOPPED.set()
    for group in list(RUNNING):
        os.killpg(group, signal.SIGKILL)


def run(records: Path, name: str, program: dict, number: int) -> dict:
    """Runs one program once, unless it has a record."""
    path = records / f"{name}.{number}.json"
    if path.exists():
        return json.loads(path.read_text())
    if STOPPED.is_set():
        raise KeyboardInterrupt
    begun = time.monotonic()
    log = path.with_suffix(".log")
    with log.open("w") as stream:
        ended = subprocess.Popen(program["command"], cwd=program["folder"], env=program["variables"], stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True)
        RUNNING.add(ended.pid)
        _, status, usage = os.wait4(ended.pid, 0)
        RUNNING.remove(ended.pid)
    if STOPPED.is_set():
        raise KeyboardInterrupt
    text = log.read_text(errors="replace")
    results = re.findall(r"^test result: .* (\d+) passed; (\d+) failed; (\d+) ignored", text, re.M)
    counts = [sum(int(result[index]) for result in results) for index in range(3)]
    row = dict(zip(["passed", "failed", "ignored"], counts), name=name, run=number, status=os.waitstatus_to_exitcode(status), seconds=round(time.monotonic() - begun, 1), processors_s=round(usage.ru_utime + usage.ru_stime, 1))
    # A program that ended before its summary has failed too.
    row["failed"] = max(row["failed"], int(row["status"] != 0))
    part = path.with_suffix(".part")
    part.write_text(json.dumps(row))
    part.rename(path)
    failures = re.findall(r"^(?:test )?(.*) (?:\.\.\.|---) FAILED$", text, re.M)
    if row["failed"]:
        print(f"{name}, run {number}: FAILED, see {log}", *failures, sep="\n    ", flush=True)
    return row


def main() -> int:
    # Cargo calls this in place of a test program.
    if sys.argv[1:2] == ["--note"]:
        note(Path(sys.argv[2]), sys.argv[3:])
        return 0
    if sys.argv[1:2] == ["--blocks"]:
        if Path(sys.argv[2]).parent.name != "deps":
            os.execv(sys.argv[2], sys.argv[2:])
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=int, help="times that each program runs")
    parser.add_argument("--side-by-side", type=int, default=4, metavar="N", help="programs at a time (4)")
    parser.add_argument("--processes", action="store_true", help=f"the packages {', '.join(PROCESSES)}")
    known, arguments = parser.parse_known_args()
    if known.runs < 1 or known.side_by_side < 1:
        parser.error("runs and programs at a time are 1 or more")
    arguments = arguments or ["--workspace"]
    records = ROOT / "target/busy" / key_of(arguments)
    programs = programs_of(records, arguments)
    if known.processes:
        programs = [(name, program) for name, program in programs if program["variables"].get("CARGO_PKG_NAME") in PROCESSES]

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    loops = [subprocess.Popen([sys.executable, "-c", LOOP, str(os.getpid())]) for _ in range(8)]
    # The longest first, as far as is known.
    took = {}
    for name, _ in programs:
        for path in records.glob(f"{name}.*.json"):
            took[name] = json.loads(path.read_text())["seconds"]
    programs.sort(key=lambda program: -took.get(program[0], 0))
    alone = {name: threading.Lock() for name, _ in programs}
    rows = []

    def lane(name: str, program: dict, number: int) -> None:
        with alone[name]:
            rows.append(run(records, name, program, number))

    try:
        with concurrent.futures.ThreadPoolExecutor(known.side_by_side) as lanes:
            turns = [lanes.submit(lane, name, program, number) for number in range(1, known.runs + 1) for name, program in programs]
            try:
                for turn in concurrent.futures.as_completed(turns):
                    turn.result()
            except BaseException:
                stop()
                raise
    finally:
        for loop in loops:
            loop.kill()
    print(f"{'run':>4} {'passed':>7} {'failed':>7} {'ignored':>8} {'processors, s':>14}")
    for number in range(1, known.runs + 1):
        sums = {field: sum(row[field] for row in rows if row["run"] == number) for field in ["passed", "failed", "ignored", "processors_s"]}
        print(f"{number:4} {sums['passed']:7} {sums['failed']:7} {sums['ignored']:8} {sums['processors_s']:14.0f}")
    return int(any(row["failed"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
