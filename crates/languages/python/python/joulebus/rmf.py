"""Open-RMF without code: the parameters of ``rmf_battery``, fitted to what robots drew.

    python -m joulebus.rmf drives/ --capacity-wh 50 --charging-a 5 > battery.yaml

The section that is printed is that of a fleet adapter's configuration. The model is that of Open-RMF: what it spends on
accelerating, on the distance and on time. A turn at a constant rate costs it nothing.
"""
from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ._optional import lab
from .lab import Recordings, _inputs, _warn
from .recordings import Trial, _reading, read_arrays, read_trials

#: Steps of the integration, s: half of Open-RMF's. Its gravity, m/s².
STEP_S, _GRAVITY = 0.25, 9.81
#: Parts of a step, over which velocities are linear.
_FINE = 8
#: Steps of a window, whose energy is one equation. Longer than a drive answers a command.
_WINDOW = 40
#: Longest time between rows that belong together, s.
_GAP_S = 1.0
#: A parameter is told from 0 if it is as many standard errors above it.
_TOLD = 2.0
#: Share of the energy that a parameter draws which is none, because Open-RMF allows no 0.
_NONE = 1e-3
#: Mean of a term, W, below which it is rounding of drives that do not have it.
_ROUNDING_W = 1e-6
#: Drives are left out in as many turns.
_TURNS = 12
_NAMES = ("mass_kg", "moment_of_inertia_kgm2", "friction_n", "ambient_w")
_ENDINGS = (".csv", ".csv.gz", ".npy", ".mcap")
#: Flags of a sample: its current is known, it is on the charger.
_CURRENT, _CHARGING = 1 << 4, 1 << 6


def terms(time_s: Any, v_mps: Any, omega_radps: Any) -> np.ndarray:
    """What a mass of 1 kg, an inertia of 1 kg m², a friction of 1 N and 1 W draw in each whole step, J.

    Of ``SimpleMotionPowerSink``: ``m |a| v + I |α| |ω| + f m g v``. `a` has the part across a curve, as there. A row's
    velocities hold until the next row.
    """
    v, omega = (_sums(time_s, np.asarray(one, float)) / STEP_S for one in (v_mps, omega_radps))
    steps = len(v)
    # Velocities are linear between the middles of the steps.
    middles = np.arange(steps) + 0.5
    fine = np.arange(steps * _FINE + 1) / _FINE
    speed, turn = (np.interp(fine, middles, one) if steps else np.zeros(1) for one in (v, omega))
    part_s = STEP_S / _FINE
    mean_v, mean_turn = (0.5 * np.abs(one[1:] + one[:-1]) for one in (speed, turn))
    accelerating = mean_v * np.hypot(np.diff(speed) / part_s, mean_v * mean_turn)
    spinning = mean_turn * np.abs(np.diff(turn)) / part_s
    found = [accelerating, spinning, mean_v, np.ones_like(mean_v)]
    return np.array([part_s * one.reshape(steps, _FINE).sum(axis=1) for one in found]).T


def _sums(time_s: Any, values: np.ndarray) -> np.ndarray:
    """Integral of values that hold until the next row, over each whole step."""
    time_s = np.asarray(time_s, float)
    total = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time_s))])
    # A last step that only rounding makes short is whole.
    steps = int((time_s[-1] - time_s[0]) / STEP_S + 1e-6)
    return np.diff(np.interp(time_s[0] + STEP_S * np.arange(steps + 1), time_s, total))


def _windows(trial: Trial) -> np.ndarray:
    """The terms and the energy of each window of a drive."""
    columns, nothing = trial.columns, np.full(len(trial), np.nan)
    commands = [columns.get(name, nothing) for name in ("v_mps", "omega_radps")]
    if not all(np.isfinite(one).any() for one in commands):
        commands = [columns.get(name, nothing) for name in ("v_measured_mps", "omega_measured_radps")]
    rows = np.array([columns["timestamp_s"], *commands, columns.get("power_w", nothing)])
    rows = rows[:, np.isfinite(rows).all(axis=0)]
    cuts = np.flatnonzero(~((0.0 < np.diff(rows[0])) & (np.diff(rows[0]) <= _GAP_S))) + 1
    found = [np.zeros((0, 5))]
    for time_s, v, omega, power_w in np.split(rows, cuts, axis=1):
        if len(time_s) > 1:
            steps = np.column_stack([terms(time_s, v, omega), _sums(time_s, power_w)])
            found += [part.sum(axis=0)[None] for part in np.split(steps, range(_WINDOW, len(steps), _WINDOW)) if len(part)]
    return np.concatenate(found)


def _solve(windows: np.ndarray, given: dict[int, float]) -> tuple[np.ndarray, list[int]]:
    """The parameters, and the places of those that the windows tell. Least squares of the windows' powers, from which
    parameters go until all are clearly above 0."""
    found = np.zeros(len(_NAMES))
    for place, value in given.items():
        found[place] = value
    left = [place for place in range(len(_NAMES)) if place not in given and windows[:, place].sum() > _ROUNDING_W * windows[:, 3].sum()]
    weights = 1.0 / np.sqrt(windows[:, 3])
    wanted = (windows[:, 4] - windows[:, :4] @ found) * weights
    while left:
        known = windows[:, left] * weights[:, None]
        # Columns of one size: masses and inertias are not.
        sizes = np.sqrt((known**2).sum(axis=0))
        inverse = np.linalg.pinv((known / sizes).T @ (known / sizes), rcond=1e-9)
        values = inverse @ ((known / sizes).T @ wanted)
        free = len(wanted) - len(left)
        errors = np.sqrt(np.diag(inverse) * ((wanted - known / sizes @ values) ** 2).sum() / max(free, 1))
        clear = values - _TOLD * errors
        if free > 0 and (clear > 0.0).all():
            found[left] = values / sizes
            return found, left
        left.pop(int(np.argmin(values / np.maximum(errors, 1e-300))))
    return found, left


@dataclass
class Fit:
    """Parameters of ``rmf_battery``, and what they miss.

    ``data`` has ``mass_kg``, ``moment_of_inertia_kgm2``, ``friction_coefficient``, ``ambient_w``, ``tool_w``,
    ``voltage_v``, ``capacity_wh`` and ``charging_a`` (None where nothing tells it), ``from`` (where each is from), and
    ``errors``: mean absolute errors of the energy of drives that were left out, relative to what was measured, of
    ``rmf_battery``, of the others' mean power, and of joulebus from the same drives.
    """

    data: dict[str, Any] = field(repr=False)

    def yaml(self) -> str:
        """The sections of a fleet adapter's configuration. One that is not known is left out, and a comment says why."""
        data, origins = self.data, self.data["from"]
        volts = data["voltage_v"]
        capacity_ah = None if None in (volts, data["capacity_wh"]) else data["capacity_wh"] / volts
        sections = {
            "battery_system": [
                ("voltage", volts, "V", "voltage_v"),
                ("capacity", capacity_ah, "Ah", "capacity_wh"),
                ("charging_current", data["charging_a"], "A", "charging_a"),
            ],
            "mechanical_system": [
                ("mass", data["mass_kg"], "kg", "mass_kg"),
                ("moment_of_inertia", data["moment_of_inertia_kgm2"], "kg m2", "moment_of_inertia_kgm2"),
                ("friction_coefficient", data["friction_coefficient"], "", "friction_coefficient"),
            ],
            "ambient_system": [("power", data["ambient_w"], "W", "ambient_w")],
            "tool_system": [("power", data["tool_w"], "W", "tool_w")],
        }
        lines = ["rmf_fleet:"]
        for section, keys in sections.items():
            missing = [origins[origin] for _, value, _, origin in keys if value is None]
            if missing:
                lines.append(f"  # {section}: yours. {' '.join(missing)}")
                continue
            lines.append(f"  {section}:")
            lines += [f"    {key}: {value:.6g}  # {unit + ', ' if unit else ''}{origins[origin]}" for key, value, unit, origin in keys]
        return "\n".join(lines) + "\n"

    def __str__(self) -> str:
        data = self.data
        rows = {"rmf_battery": "rmf_battery", "mean_power": "mean power of the others", "joulebus": "joulebus"}
        found = [f"{text} {100.0 * data['errors'][name]:.1f} %" for name, text in rows.items() if data["errors"][name] is not None]
        return f"{data['drives']} drives, {data['driven_s'] / 60.0:.1f} min. Energy of a drive that was left out is missed by: " + (
            ", ".join(found) or "unknown, of one drive"
        )


def fit(
    recordings: Recordings,
    *,
    mass_kg: float | None = None,
    moment_of_inertia_kgm2: float | None = None,
    voltage_v: float | None = None,
    capacity_wh: float | None = None,
    charging_a: float | None = None,
    hotel_w: float = 0.0,
    tool_w: float = 0.0,
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
) -> Fit:
    """Fits ``rmf_battery``'s parameters to recordings with velocities and power: files, folders, captures, `Trial` objects.

    mass_kg, moment_of_inertia_kgm2: known ones. Others are fitted where the drives tell them. Accelerating and braking
                 both cost Open-RMF energy, so a fitted mass is what makes it right, and no weight
    voltage_v, capacity_wh, charging_a: of the battery. Else the mean voltage, and of a capture the capacity by which its
                 worker counted, and the current on the charger
    hotel_w:     consumption that the recorded power lacks, W: it is added to the ambient power
    tool_w:      consumption of a tool, which no recording tells from the rest, W
    columns, current, accept: how recordings are read, as of `train`

    Each drive is left out in turn, or several of more than twelve.
    """
    given = {"mass_kg": mass_kg, "moment_of_inertia_kgm2": moment_of_inertia_kgm2, "voltage_v": voltage_v}
    given |= {"capacity_wh": capacity_wh, "charging_a": charging_a}
    for name, value in (given | {"hotel_w": hotel_w, "tool_w": tool_w}).items():
        least = ">= 0" if name in ("hotel_w", "tool_w") else "> 0"
        if value is not None and not (np.isfinite(value) and (value > 0.0 or value == 0.0 and least == ">= 0")):
            raise ValueError(f"{name} is {value}, allowed: a finite number {least}")
    paths, trials = _read(recordings, columns, current, accept)
    drives = [(trial, windows) for trial in trials if len(windows := _windows(trial))]
    if not drives:
        raise ValueError(f"none of {len(trials)} recordings has velocities and power for {STEP_S} s, in rows up to {_GAP_S:g} s apart: give some")
    parts = [windows for _, windows in drives]
    every = np.concatenate(parts)
    fixed = {at: value for at, value in enumerate([mass_kg, moment_of_inertia_kgm2]) if value is not None}
    found, told = _solve(every, fixed)
    if not (found * every[:, :4].sum(axis=0)).sum() > 0.0:
        raise ValueError(f"the drives drew {every[:, 4].sum():.3g} J, which tells no parameter, give some that consume")
    data: dict[str, Any] = {"drives": len(drives), "driven_s": float(every[:, 3].sum()), "tool_w": float(tool_w)}
    origins = {"tool_w": "given" if tool_w else "not given: part of the ambient power"}
    for at, name in enumerate(_NAMES):
        origins[name] = "given" if at in fixed else "fitted" if at in told else "not told by these drives, near nothing"
        if not found[at] and at < 3:
            drawn = every[:, at].sum()
            found[at] = _NONE * abs(every[:, 4].sum()) / drawn if drawn > _ROUNDING_W * every[:, 3].sum() else 1.0
    data |= {"mass_kg": float(found[0]), "moment_of_inertia_kgm2": float(found[1]), "ambient_w": float(found[3] + hotel_w)}
    data["friction_coefficient"] = float(found[2] / (_GRAVITY * found[0]))
    # Whoever writes a weight there changes the friction, too.
    origins["friction_coefficient"] = origins.pop("friction_n") + ("" if 0 in fixed else ", for this mass")
    if hotel_w:
        origins["ambient_w"] += f", and {hotel_w:g} W given"
    _battery(data, origins, given, paths, [trial for trial, _ in drives])
    data |= {"from": origins, "errors": _errors(drives, fixed, (columns, current, accept))}
    return Fit(data)


def _errors(drives: list[tuple[Trial, np.ndarray]], fixed: dict[int, float], reading: Any) -> dict[str, float | None]:
    turns = min(len(drives), _TURNS)
    missed: list[list[float]] = []
    for turn in range(turns if turns > 1 else 0):
        others = np.concatenate([windows for at, (_, windows) in enumerate(drives) if at % turns != turn])
        found, _ = _solve(others, fixed)
        mean_w = others[:, 4].sum() / others[:, 3].sum()
        for at in range(turn, len(drives), turns):
            drawn = drives[at][1].sum(axis=0)
            expected = np.array([found @ drawn[:4], mean_w * drawn[3]])
            missed.append(np.abs(expected / drawn[4] - 1.0).tolist())
    rmf, mean = np.mean(missed, axis=0).tolist() if missed else (None, None)
    trips = json.loads(lab("trips").trips(_inputs([trial for trial, _ in drives]), _reading(*reading), _warn))
    whole = [row["mape"] for row in trips["rows"] if row["left_out"] == "drive" and row["length_s"] is None]
    return {"rmf_battery": rmf, "mean_power": mean, "joulebus": whole[0] if whole else None}


def _battery(
    data: dict[str, Any], origins: dict[str, str], given: dict[str, float | None], paths: list[Path], trials: list[Trial]
) -> None:
    """What is given, else measured, of a battery."""
    volts = np.concatenate([trial.columns.get("voltage_v", np.zeros(0)) for trial in trials])
    capacities_wh, charging_a = [], []
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # read_trials has said what is damaged.
            budgets, samples = read_arrays(path, "budgets"), read_arrays(path, "samples")
        with np.errstate(invalid="ignore", divide="ignore"):
            capacities_wh.append(budgets["left_j"] / budgets["soc"] / 3600.0)
        is_charge = (samples["flags"] & (_CURRENT | _CHARGING)) == _CURRENT | _CHARGING
        charging_a.append(-samples["current_a"][is_charge].astype(float))
    for name, values, origin, option in (
        ("voltage_v", volts, "mean of the readings", "--voltage-v"),
        ("capacity_wh", np.concatenate([*capacities_wh, np.zeros(0)]), "by which the worker counted", "--capacity-wh"),
        ("charging_a", np.concatenate([*charging_a, np.zeros(0)]), "mean of the readings on the charger", "--charging-a"),
    ):
        values, value = values[np.isfinite(values) & (values > 0.0)], given[name]
        data[name] = float(value) if value is not None else float(np.mean(values)) if len(values) else None
        origins[name] = "given" if value is not None else origin if len(values) else f"{name} is unknown: {option}."
    if data["capacity_wh"] is not None and data["voltage_v"] is not None:
        origins["capacity_wh"] = f"{data['capacity_wh']:.6g} Wh {origins['capacity_wh']}"


def _read(recordings: Recordings, *reading: Any) -> tuple[list[Path], list[Trial]]:
    """The captures, and all drives."""
    captures, trials = [], []
    single = isinstance(recordings, (str, os.PathLike, Trial))
    for one in [recordings] if single else recordings:
        if isinstance(one, Trial):
            trials.append(one)
            continue
        for path in _files(Path(one)):
            trials += read_trials(path, columns=reading[0], current=reading[1], accept=reading[2])
            captures += [path] if path.name.endswith(".mcap") else []
    return captures, trials


def _files(path: Path) -> Iterator[Path]:
    if not path.is_dir():
        yield path
        return
    found = [one for one in sorted(path.rglob("*")) if one.name.endswith(_ENDINGS) and one.is_file()]
    if not found:
        raise FileNotFoundError(f"{path} has no recording, allowed are {', '.join(_ENDINGS)}")
    yield from found


def _main() -> int:
    parser = argparse.ArgumentParser(prog="python -m joulebus.rmf", description="Prints rmf_battery's parameters as YAML.")
    parser.add_argument("recordings", nargs="+", help="CSV, .npy, captures, or folders of them")
    for name, text in (
        ("mass-kg", "the robot's mass, instead of one that is fitted"),
        ("moment-of-inertia-kgm2", "the same of its inertia"),
        ("voltage-v", "the battery's voltage [default: mean of the readings]"),
        ("capacity-wh", "the battery's energy from full to empty [default: of a capture]"),
        ("charging-a", "the charger's current [default: of a capture]"),
        ("hotel-w", "consumption that the recorded power lacks"),
        ("tool-w", "consumption of a tool"),
    ):
        parser.add_argument(f"--{name}", type=float, default=0.0 if name in ("hotel-w", "tool-w") else None, help=text)
    parser.add_argument("--accept", action="append", default=[], help="a finding to let through, as of `joulebus train`")
    parser.add_argument("--current", choices=["discharge-positive", "discharge-negative"], help="the sign of the current")
    parser.add_argument("--map", dest="columns", action="append", default=[], metavar="QUANTITY=COLUMN", help="a column")
    given = vars(parser.parse_args())
    given["columns"] = dict(pair.split("=", 1) for one in given["columns"] for pair in one.split(",")) or None
    try:
        found = fit(given.pop("recordings"), **given)
    except Exception as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(found, file=sys.stderr)
    print(found.yaml(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(_main())
