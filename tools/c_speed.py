#!/usr/bin/env python3
"""What a call from C++ costs beside the same call from Rust, beside a real worker: `tools/c_speed.py`.

Two programs, of the release profile and of -O3, make the same calls, in rounds that alternate between them, so that each ratio is of
neighbours in time. Medians are printed. Needs c++. Builds library and program first.
"""

import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Each call, how often in a round, and what it is.
CALLS = {
    "predict_1": (4000, "forecast of 1 robot"),
    "predict_100": (100, "forecasts of 100 robots"),
    "predict_1000": (10, "forecasts of 1,000 robots"),
    "what_if": (40, "16 plans of 50 steps"),
    "latest": (2000, "newest frame, power of 100 robots summed"),
    "publish": (20, "a frame of 100 robots"),
}
FLEET = """
[fleet]
name = "speed"
[domain]
root = "/dev/shm/jbs{pid}.d"
prefix = "s{pid}_"
[[platform]]
file = "builtin:gternal"
robots = ["0-299"]
[platform.battery]
capacity_wh = 5.0
initial_soc_lo = 0.95
"""


def built(folder: Path) -> tuple[Path, Path, Path]:
    """joulebus, the calls from C++, and those from Rust."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
    wanted = ["-p", "joulebus", "-p", "joulebus-c", "--lib", "--bins", "--example", "calls"]
    subprocess.run(["cargo", "build", "--release", "--locked", "--quiet", *wanted], check=True, cwd=ROOT)
    prefix = folder / "prefix"
    install = [ROOT / "tools/install_c.sh", "--prefix", prefix, "--from", target]
    subprocess.run(install, check=True, stdout=subprocess.DEVNULL)
    calls = folder / "calls"
    flags = ["-std=c++17", "-O3", f"-I{prefix}/include", f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib", "-ljoulebus"]
    subprocess.run(["c++", ROOT / "crates/languages/c/tests/speed/calls.cpp", *flags, "-o", calls], check=True)
    return target / "joulebus", calls, target / "examples" / "calls"


def timed(program: subprocess.Popen, call: str, times: int) -> float:
    """Time of one call, µs."""
    program.stdin.write(f"{call} {times}\n")
    program.stdin.flush()
    answer = program.stdout.readline()
    if not answer:
        raise SystemExit(f"{program.args[0]} ended at {call}")
    return int(answer) * 1e-3 / times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=101, help="paired measurements of each call [default: 101]")
    parser.add_argument("--format", choices=["text", "json"], default="text")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        joulebus, cpp, rust = built(folder)
        config = folder / "fleet.toml"
        config.write_text(FLEET.format(pid=os.getpid() % 1_000_000))
        environment = os.environ | {"XDG_STATE_HOME": name}
        started = []

        def start(*command: object, **pipes: object) -> subprocess.Popen:
            words = [str(word) for word in command]
            started.append(subprocess.Popen(words, env=environment, text=True, **pipes))
            return started[-1]

        try:
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            start(joulebus, "run", "--config", config, **quiet)
            start(joulebus, "publish", "sim", "--config", config, "--robots", 100, **quiet)
            # The robots begin when they begin.
            time.sleep(2.0)
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            pair = [start(cpp, config, **pipes), start(rust, config, **pipes)]
            rows = [compared(pair, call, *CALLS[call], asked.rounds) for call in CALLS]
        finally:
            for process in reversed(started):
                process.terminate()
                process.wait()
    if asked.format == "json":
        print(json.dumps(rows))
        return
    for row in rows:
        print("{call:42} C++ {cpp_us:8.2f} µs, Rust {rust_us:8.2f} µs, ratio {ratio:.3f}".format(**row))


def compared(pair: list[subprocess.Popen], call: str, times: int, text: str, rounds: int) -> dict:
    """Medians of a call's time in both, and of their ratio."""
    found = []
    for place in range(rounds + 1):
        # Neither is always the first.
        order = [0, 1] if place % 2 == 0 else [1, 0]
        took = {which: timed(pair[which], call, times) for which in order}
        if place > 0:
            found.append((took[0], took[1]))
    return {
        "call": text,
        "cpp_us": statistics.median(cpp for cpp, _ in found),
        "rust_us": statistics.median(rust for _, rust in found),
        "ratio": statistics.median(cpp / rust for cpp, rust in found),
    }


if __name__ == "__main__":
    main()
