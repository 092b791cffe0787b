"""Gradient boosting's forecasts one tick ahead, by LightGBM with plain settings: `tools/benchmark.py` runs it.

Reads `[files to learn from, files to forecast]` as JSON from stdin, and writes the CSV that `joulebus eval
--forecasts` reads. Features: the command, its change and size, five readings, and means of 16, 64 and all readings.
"""
import csv
import gzip
import json
import os
import sys

import lightgbm
import numpy as np

LAGS = 5
COLUMNS = ["timestamp_s", "v_cmd_mps", "omega_cmd_radps", "power_mW"]
SETTINGS = {"learning_rate": 0.05, "num_leaves": 31, "min_child_samples": 50, "seed": 0, "deterministic": True,
            "force_row_wise": True, "num_threads": 1, "verbosity": -1}
TREES = 300


def rows(path):
    """Features, targets in W, and numbers of the rows that are forecast."""
    with gzip.open(path, "rt") as file:
        names = file.readline().strip().split(",")
        table = np.genfromtxt(file, delimiter=",", usecols=[names.index(name) for name in COLUMNS])
    time_s, v, omega, power_w = table.T * np.array([[1], [1], [1], [1e-3]])
    at = np.arange(LAGS, len(power_w))
    step_s = np.maximum(time_s[at] - time_s[at - 1], 1e-3)
    lags = [power_w[at - lag] for lag in range(1, LAGS + 1)]
    sums = np.concatenate([[0], np.cumsum(power_w)])
    means = [(sums[at] - sums[np.maximum(at - width, 0)]) / np.minimum(at, width) for width in (16, 64, len(power_w))]
    change = lambda command: (command[at] - command[at - 1]) / step_s
    commands = [v[at], omega[at], change(v), change(omega), abs(v[at]), abs(omega[at])]
    return np.column_stack([*commands, *lags, *means]), power_w[at], at + 1


def main():
    learned, forecast = json.load(sys.stdin)
    features, targets = (np.concatenate(part) for part in list(zip(*map(rows, learned)))[:2])
    asked = [{"objective": "regression"}, *({"objective": "quantile", "alpha": alpha} for alpha in (0.05, 0.95))]
    models = [lightgbm.train({**SETTINGS, **one}, lightgbm.Dataset(features, targets), TREES) for one in asked]
    with open(sys.argv[1], "w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["recording", "row", "power_w", "lo_w", "hi_w"])
        for path in forecast:
            features, _, numbers = rows(path)
            power_w, one, other = (model.predict(features) for model in models)
            ends = zip(np.minimum(one, other), np.maximum(one, other))
            for number, value, (lo, hi) in zip(numbers, power_w, ends):
                out.writerow([os.path.basename(path), number, f"{value:.5g}", f"{lo:.5g}", f"{hi:.5g}"])


if __name__ == "__main__":
    main()
