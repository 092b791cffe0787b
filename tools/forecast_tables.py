#!/usr/bin/env python3
"""Measures what is forecast, and prints the tables of docs/measured/online.md.

    python3 tools/forecast_tables.py            # about 40 minutes after the builds
    python3 tools/forecast_tables.py --short    # 10 minutes: the first table alone

The first table: demos of 5, 20 and 60 s with three seeds, 100 robots each; the tick with learning, intervals,
diagnostics, alarms and budgets beside the bare kernel; the time to train the shipped model and to
evaluate recordings. The second: every line of the benchmark `online_learning`, which needs ../shared/data.
Standard library only.
"""
import json
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import figures  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parent.parent
SEEDS = (1, 2, 3)
ROBOTS = 100


def run(*command):
    print("==", *command, file=sys.stderr)
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def built():
    """The directory of the programs."""
    run("cargo", "build", "--release", "--locked", "-p", "joulebus", "-p", "joulebus-lab", "-p", "joulebus-bench")
    metadata = run("cargo", "metadata", "--no-deps", "--format-version", "1")
    return pathlib.Path(json.loads(metadata)["target_directory"]) / "release"


def demo(programs, seconds):
    """Medians over the seeds; alarms are summed."""
    summaries = [
        json.loads(run(programs / "joulebus", "demo", "--format", "json", "--no-capture", "--robots", str(ROBOTS),
                       "--duration", str(seconds), "--seed", str(seed)))
        for seed in SEEDS
    ]
    score = lambda name: statistics.median(summary["scores"][name] for summary in summaries)
    raised = [out for summary in summaries for out in summary["stand_out"]]
    alarmed = [out for out in raised if out["planted"] is None]
    faulty = len(raised) - len(alarmed) + sum(len(summary["unnoticed"]) for summary in summaries)
    healthy = sum(summary["robots"] for summary in summaries) - faulty
    return [
        f"demo, {seconds} s, {len(SEEDS)} × {ROBOTS} robots",
        f"RMSE {score('rmse_w'):.3f} W (persistence {score('persistence_rmse_w'):.3f}), "
        f"MAE {score('mae_w'):.4f} W ({score('persistence_mae_w'):.4f}), R² {score('r2'):.3f} "
        f"({score('persistence_r2'):.3f}), {100 * score('better_than_persistence'):.0f} % of the robots with a smaller "
        f"squared error, {len(alarmed)} of {healthy} robots without a fault raised an alarm",
    ]


def tick(programs):
    with tempfile.NamedTemporaryFile(suffix=".json") as file:
        run(programs / "joulebus-bench", "tick", "--fleet", "learning", "--robots", "1000", "--json", file.name)
        suite = json.load(open(file.name))
    found = {figure["name"]: figure for report in suite["reports"] for figure in report["figures"]}
    over, cost = found["tick_over_kernel"]["p50"], found["tick_ns_per_robot"]["p50"]
    return figures.describe(suite), [
        "tick of 1,000 robots, all on", f"{over:.2f} × the bare kernel, {figures.shown(cost)} ns a robot (medians of paired rounds)"
    ]


def train(programs):
    with tempfile.TemporaryDirectory() as directory:
        begin = time.monotonic()
        run(programs / "joulebus", "train", "sim", "--seed", "7", "--out", f"{directory}/model.safetensors")
        return ["training of the shipped model (`train sim`)", f"{time.monotonic() - begin:.1f} s"]


def evaluate():
    """The benchmark's time for everything that `eval` reports, on two threads."""
    said = run("cargo", "bench", "--locked", "-p", "joulebus-eval", "--bench", "eval")
    found = re.search(r"2 thread\(s\): (corrected and open loop, all rows.*?) ([\d.]+) s", said)
    return [[f"evaluation of all Robotino recordings, {found[1]}", f"{found[2]} s"]] if found else []


def online_learning():
    """The benchmark's own table."""
    said = run("cargo", "bench", "--locked", "-p", "joulebus-eval", "--bench", "online_learning")
    return "".join(line for line in said.splitlines(keepends=True) if line.startswith("|"))


def main():
    if sys.argv[1:] not in ([], ["--short"]):
        sys.exit(__doc__)
    programs = built()
    rows = [demo(programs, seconds) for seconds in (5, 20, 60)]
    machine, cost = tick(programs)
    rows += [cost, train(programs), *evaluate()]
    print(f"{machine}\n\n{figures.table(['what', 'result'], rows)}\n")
    if not sys.argv[1:]:
        print(online_learning())


if __name__ == "__main__":
    main()
