#!/usr/bin/env python3
"""Instructions a robot of kernel, tick and rollout: figures that hold on a busy machine.

    python3 tools/instructions.py [--json bench-results/instructions.json] [--compare OLD.json]

Needs valgrind (`apt install valgrind`). Callgrind counts what one call executes after a warm-up.
Valgrind knows no AVX-512, so that AVX2 is counted, and a kernel without vector instructions.
Counts are no times: caches and waiting are not in them. The same build gives the same counts.
"""
import argparse
import json
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import figures  # noqa: E402

# Work, sizes, unit of a forecast.
CASES = [
    ("kernel", [1, 7, 20, 100, 1_000], "robot"),
    ("take", [100, 1_000], "robot"),
    ("forecast", [100, 1_000], "robot"),
    ("account", [100, 1_000], "robot"),
    ("outlooks", [100, 1_000], "robot"),
    ("rollout", [16, 64, 256], "step"),
]
# Without vector instructions multiply-adds are emulated: thousands of instructions each.
SLOW_SIZES = [1, 7]


def cargo_build():
    command = ["cargo", "build", "--release", "--locked", "-p", "joulebus-bench", "--bin", "joulebus-bench",
               "--message-format", "json-render-diagnostics"]
    out = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    made = [message.get("executable") for line in out.splitlines() if (message := json.loads(line))["reason"] == "compiler-artifact"]
    return [path for path in made if path][-1]


def count(program, what, size, kernel):
    with tempfile.TemporaryDirectory() as place:
        out = pathlib.Path(place) / "out"
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", "--collect-atstart=no",
                   "--toggle-collect=joulebus_bench::callgrind::collected*", program, "count", what, str(size)]
        if kernel:
            command += ["--kernel", kernel]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode != 0:
            sys.exit(f"{' '.join(command)}\n{run.stderr}")
        found = re.search(r"^(?:summary|totals): (\d+)", out.read_text(), re.MULTILINE)
    kernel, forecasts = run.stdout.split()
    total = int(found.group(1)) if found else 0
    if total == 0:
        sys.exit(f"{what} {size}: callgrind collected nothing: is the function `collected` gone?")
    return kernel, total / int(forecasts)


def compare(old, new):
    key = lambda figure: (figure["name"], figure["case"])
    before = {key(figure): figure["p50"] for report in old["reports"] for figure in report["figures"]}
    for figure in new["reports"][0]["figures"]:
        was = before.get(key(figure))
        if was is not None:
            print(f"{figure['name']}, {figure['case']}: {was:.1f} → {figure['p50']:.1f}, old/new {was / figure['p50']:.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=pathlib.Path, default=ROOT / "bench-results/instructions.json")
    parser.add_argument("--compare", type=pathlib.Path)
    arguments = parser.parse_args()
    old = json.loads(arguments.compare.read_text()) if arguments.compare else None
    program = cargo_build()
    made = []
    slow = [("kernel", SLOW_SIZES, "robot", "scalar")]
    for what, sizes, unit, kernel in [(*case, None) for case in CASES] + slow:
        for size in sizes:
            name, each = count(program, what, size, kernel)
            case = figures.robots(size) if unit == "robot" else f"{size} candidates x 50 steps"
            figure = figures.figure(f"{name}_{what}_instructions_per_{unit}", case, "instructions", [each])
            made.append(figure)
            print(f"{figure['name']:<44} {case:<26} {each:>12,.1f}")
    version = subprocess.run(["valgrind", "--version"], capture_output=True, text=True).stdout.strip()
    notes = ["One call after a warm-up. Valgrind has no AVX-512; caches and waiting are not in counts."]
    suite = figures.suite(ROOT, [figures.report("instructions", {"counted_by": version}, made, notes)])
    figures.write(arguments.json, suite)
    if old:
        compare(old, suite)


if __name__ == "__main__":
    main()
