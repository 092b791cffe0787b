"""What a call from Python costs beside the same call in Rust: `python -m joulebus.speed`.

Rounds alternate between the two, and each round's ratio is of neighbours in time; the medians are printed.
"""
from __future__ import annotations

import argparse
import json
import statistics
import time

import numpy as np

from . import EnergyPredictor, Predictor

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


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m joulebus.speed", description=__doc__)
    parser.add_argument("--rounds", type=int, default=101, help="paired measurements [default: 101]")
    parser.add_argument("--format", choices=["text", "json"], default="text")
    parser.add_argument("--robotarium", action="store_true", help="a step of EnergyRobotarium beside that of rps instead")
    asked = parser.parse_args()
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
