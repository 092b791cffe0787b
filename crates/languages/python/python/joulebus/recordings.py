"""Captures and recorded trials, as arrays and data frames."""
from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import _native
from ._optional import lab, needed
from .live import BUDGET, DIAGNOSTIC, FORECAST, OUTLOOK, _columns, _dtype

#: NumPy's type of a sample: names and units as in `joulebus-wire`.
SAMPLE = _dtype(_native.SAMPLE)

_ROWS = {
    "samples": SAMPLE,
    "forecasts": FORECAST,
    "diagnostics": DIAGNOSTIC,
    "budgets": BUDGET,
    "outlooks": OUTLOOK,
}


class RecordingDamaged(UserWarning):
    """A capture is damaged. The readable part was returned."""


def read_arrays(
    path: str | os.PathLike[str], topic: str, *, fleet: str | None = None, robots: Any = None
) -> dict[str, np.ndarray]:
    """What a capture (`joulebus record`, MCAP) holds of ``samples``, ``forecasts``, ``diagnostics``, ``budgets``
    or ``outlooks``.

    One element for each robot and message, in the order of the file: the fields of
    `joulebus.SAMPLE`, `FORECAST`, `DIAGNOSTIC`, `BUDGET` or `OUTLOOK`, to the bit, and of its
    message ``tick`` (number of the source's frame, of samples), ``log_ns`` (received by the
    recorder, Unix ns) and ``sent_ns``. `robots` selects by id. `fleet` is needed where the capture
    has several. From a damaged file, the rows before the damage are returned, with a warning
    `RecordingDamaged`.
    """
    told = lab("captures").read_capture(path, topic, fleet, robots)
    if told["damage"] is not None:
        warnings.warn(f"{os.fspath(path)}: {told['damage']}", RecordingDamaged, stacklevel=2)
    rows = told["bytes"].view(_ROWS[topic])
    found = {name: np.repeat(told[name], told["rows"]) for name in ("tick", "log_ns", "sent_ns")}
    return found | {name: rows[name] for name in rows.dtype.names}


def read(path: str | os.PathLike[str], topic: str, *, fleet: str | None = None, robots: Any = None) -> Any:
    """As `read_arrays`, as a DataFrame. Needs pandas."""
    pandas = needed("pandas", "data frames")
    return pandas.DataFrame(_columns(read_arrays(path, topic, fleet=fleet, robots=robots)))


@dataclass
class Trial:
    """What one robot recorded in one run, in SI units.

    ``columns`` has ``timestamp_s`` and, as far as recorded, ``v_mps`` and ``omega_radps`` (commands), ``power_w``,
    ``voltage_v``, ``current_a``, ``x_m``, ``y_m``, ``theta_rad``, ``v_measured_mps``, ``omega_measured_radps``, ``soc``
    and ``phase``: float64, NaN where nothing was recorded. ``name`` is the file's, or what it shall be called in reports.
    """

    columns: dict[str, np.ndarray]
    robot: str | None = field(default=None)
    name: str | None = field(default=None)

    def write(self, path: str | os.PathLike[str], *, accept: Sequence[str] = ()) -> None:
        """Writes .csv, .csv.gz or .npy, as all of joulebus reads them (mV, mA, mW).

        A trial with another sign or unit, or other implausible readings, raises `RecordingError`. `accept` names findings
        to let through.
        """
        lab("trials").write_trial(path, self.robot or "", self.columns, _names(accept))

    def rows(self, *, accept: Sequence[str] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Features ``(rows, 13)`` and the readings that followed, W: what `Predictor.fit`, `predict` and `score` take.

        One row for each reading with five gapless readings before it. The features are those that the worker would have
        computed, to the bit. `accept` as of `write`.
        """
        return lab("trials").trial_rows(self.columns, _names(accept))

    def to_pandas(self) -> Any:
        """A copy as a DataFrame. Needs pandas."""
        return needed("pandas", "data frames").DataFrame(self.columns)

    def __len__(self) -> int:
        return len(self.columns["timestamp_s"])

    def __repr__(self) -> str:
        return f"Trial(robot={self.robot!r}, rows={len(self)}, columns=[{', '.join(self.columns)}])"


def read_trials(
    path: str | os.PathLike[str],
    *,
    columns: dict[str, str] | None = None,
    current: str | None = None,
    accept: Sequence[str] = (),
) -> list[Trial]:
    """The trials of a file (.npy, .csv, .csv.gz, or a capture): one for each robot.

    columns: columns of a CSV whose names joulebus does not know: ``{"power": "load_W"}``
    current: sign of the current: ``discharge-positive`` (default) or ``discharge-negative``
    accept:  findings to let through, because you know better: ``sign``, ``unit``, … Others that make numbers wrong raise
             `RecordingError`
    """
    found, name = lab("trials").read_trials(path, _reading(columns, current, accept)), os.fspath(path)
    several = len(found) > 1
    return [Trial(columns, robot, f"{name} {robot}" if several else name) for robot, columns in found]


def _names(accept: Sequence[str]) -> list[str]:
    return [accept] if isinstance(accept, str) else list(accept)


def _reading(
    columns: dict[str, str] | None, current: str | None, accept: Sequence[str]
) -> tuple[list[str], str | None, list[str]]:
    mapped = [f"{quantity}={column}" for quantity, column in (columns or {}).items()]
    return mapped, current, _names(accept)
