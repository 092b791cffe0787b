"""What a call from Python costs beside the same call in Rust: `python -m joulebus.speed`.

Rounds alternate between the two, and each round's ratio is of neighbours in time. The medians are printed.
"""
from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import threading
import time
from pathlib import Path
from typing import Callable

import numpy as np

from . import EnergyPredictor, Predictor, evaluate, report, simulate, train

FLEET = 1_000


def compared(predictor: Predictor, robots: int, rounds: int) -> dict[str, float]:
    """Medians of a call's time in Python and in Rust, s, and of their ratio."""
    noise = np.random.default_rng(7)
    features = noise.uniform(0.0, 4.0, (robots, 11)).astype(np.float32)
    calls = max(1, 2_000 // robots)
    pairs = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for _ in range(calls):
            predictor.predict(features)
        pairs.append(((time.perf_counter() - begin) / calls, predictor._rust_call_s(features, calls)))
    return {
        "robots": robots,
        "python_us": 1e6 * statistics.median(python for python, _ in pairs),
        "rust_us": 1e6 * statistics.median(rust for _, rust in pairs),
        "ratio": statistics.median(python / rust for python, rust in pairs),
    }


def one_step(rounds: int) -> float:
    """Median time of `EnergyPredictor.step`, µs."""
    predictor, calls = EnergyPredictor(), 2_000
    times = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for _ in range(calls):
            predictor.step(0.1, 0.5)
        times.append((time.perf_counter() - begin) / calls)
    return 1e6 * statistics.median(times)


def robotarium_steps(robots: int, rounds: int) -> tuple[float, float]:
    """Median times of a step of `rps.robotarium.Robotarium` and of `EnergyRobotarium`, without a figure, µs."""
    from rps.robotarium import Robotarium

    from .robotarium import EnergyRobotarium

    poses = np.vstack([np.linspace(-1.5, 1.5, robots), np.zeros((2, robots))])
    arguments = dict(
        number_of_robots=robots, initial_conditions=poses, sim_in_real_time=False, skip_initialization=True
    )
    pair = (Robotarium(**arguments), EnergyRobotarium(chargers=[[0.0], [0.0]], **arguments))
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(10 * rounds):
        for robotarium, found in zip(pair, times):
            robotarium.get_poses()
            robotarium.set_velocities(np.arange(robots), np.full((2, robots), 0.1))
            begin = time.perf_counter()
            robotarium.step()
            found.append(time.perf_counter() - begin)
    return 1e6 * statistics.median(times[0]), 1e6 * statistics.median(times[1])


def interrupted_ms(call: Callable[[], object], after_s: float) -> float:
    """Time from Ctrl-C, `after_s` into a computation, to its KeyboardInterrupt, ms."""
    sent: list[float] = []

    def interrupt() -> None:
        names = Path("/proc/self/task").glob("*/comm")
        while not any(name.read_text().strip() == "joulebus-lab" for name in names):
            time.sleep(0.001)
            names = Path("/proc/self/task").glob("*/comm")
        time.sleep(after_s)
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        call()
    except KeyboardInterrupt:
        ended = time.perf_counter()
    else:
        raise RuntimeError("the computation ended before it was interrupted")
    finally:
        thread.join()
    return 1e3 * (ended - sent[0])


def interruptions(rounds: int) -> None:
    trials = simulate(1, steps=2000, progress=False).trials
    noise = np.random.default_rng(7)
    calls: dict[str, Callable[[], object]] = {
        "train": lambda: train(trials, split="time", max_epochs=10**6, patience=10**6, progress=False),
        "evaluate": lambda: evaluate(trials * 20, resamples=0, progress=False),
        "report": lambda: report(simulated=True, draws=900, progress=False),
    }
    for name, call in calls.items():
        found = [interrupted_ms(call, noise.uniform(0.0, 0.2)) for _ in range(rounds)]
        print(f"Ctrl-C in {name}: {statistics.median(found):.1f} ms, at most {max(found):.1f} ms, {rounds} times")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m joulebus.speed", description=__doc__)
    parser.add_argument("--rounds", type=int, default=101, help="paired measurements [default: 101]")
    parser.add_argument("--format", choices=["text", "json"], default="text")
    parser.add_argument("--robotarium", action="store_true", help="a step of EnergyRobotarium beside that of rps instead")
    parser.add_argument("--interrupt", action="store_true", help="the time from Ctrl-C to KeyboardInterrupt instead")
    asked = parser.parse_args()
    if asked.interrupt:
        interruptions(asked.rounds)
        return
    if asked.robotarium:
        for robots in (1, 5, 10, 15):
            plain_us, energy_us = robotarium_steps(robots, asked.rounds)
            print(f"step, {robots:2} robots: {energy_us:.1f} µs, rps {plain_us:.1f} µs, ratio {energy_us / plain_us:.3f}")
        return
    predictor = Predictor()
    found = [compared(predictor, robots, asked.rounds) for robots in (1, 100, FLEET)]
    step_us = one_step(asked.rounds)
    if asked.format == "json":
        print(json.dumps({"predict": found, "energy_predictor_step_us": step_us}))
        return
    for row in found:
        print("predict, {robots:5} robots: {python_us:8.2f} µs, Rust {rust_us:8.2f} µs, ratio {ratio:.3f}".format(**row))
    print(f"EnergyPredictor.step, 1 robot: {step_us:.2f} µs")


if __name__ == "__main__":
    main()
