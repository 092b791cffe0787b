"""Captures and recorded trials, as arrays and data frames."""
from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
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


#: A time of a capture: seconds after its first message, or a moment.
_Time = float | datetime | np.datetime64
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
#: Longest offset, s: more is a time since 1970.
_LONGEST_S = 1e9


def read_arrays(
    path: str | os.PathLike[str],
    topic: str,
    *,
    start: _Time | None = None,
    stop: _Time | None = None,
    fleet: str | None = None,
    robots: Any = None,
) -> dict[str, np.ndarray]:
    """What a capture (`joulebus record`, MCAP) holds of ``samples``, ``forecasts``, ``diagnostics``, ``budgets``
    or ``outlooks``, as a dict of arrays, which Polars takes.

    One element for each robot and message, in the order of the file: the fields of
    `joulebus.SAMPLE`, `FORECAST`, `DIAGNOSTIC`, `BUDGET` or `OUTLOOK`, to the bit, and of its
    message ``tick`` (number of the source's frame, of samples), ``log_ns`` (received by the
    recorder, Unix ns) and ``sent_ns``.

    start, stop: the part of the capture whose ``log_ns`` is at or after `start` and before `stop`: seconds after the
                 capture's first message, a `datetime` with a time zone, or a `numpy.datetime64` (UTC)
    fleet:       needed where the capture has several
    robots:      selects by id

    From a damaged file, the rows before the damage are returned, with a warning `RecordingDamaged`.
    """
    part = _capture(path, topic, start, stop, fleet, robots).take(sys.maxsize)
    if part["damage"] is not None:
        warnings.warn(f"{os.fspath(path)}: {part['damage']}", RecordingDamaged, stacklevel=2)
    return _arrays(part, topic)


def read(
    path: str | os.PathLike[str],
    topic: str,
    *,
    start: _Time | None = None,
    stop: _Time | None = None,
    fleet: str | None = None,
    robots: Any = None,
) -> Any:
    """As `read_arrays`, as a DataFrame. Needs pandas."""
    pandas = needed("pandas", "data frames")
    return pandas.DataFrame(_columns(read_arrays(path, topic, start=start, stop=stop, fleet=fleet, robots=robots)))


def read_frames(
    path: str | os.PathLike[str],
    topic: str,
    *,
    rows: int = 1,
    start: _Time | None = None,
    stop: _Time | None = None,
    fleet: str | None = None,
    robots: Any = None,
) -> Iterator[dict[str, np.ndarray]]:
    """As `read_arrays`, message by message: memory holds one part of the capture, however long it is.

    Each item is a dict of columns, which ``pandas.DataFrame`` and ``polars.DataFrame`` take. It has the frame of the whole
    fleet that a planner saw, or several whole frames that have `rows` rows together. Frames without a selected robot are
    left out. A warning `RecordingDamaged` comes after the last item before the damage.

        for number, part in enumerate(joulebus.read_frames("run.mcap", "samples", rows=1_000_000)):
            pandas.DataFrame(part).to_parquet(f"run-{number:04}.parquet")
    """
    if isinstance(rows, bool) or not isinstance(rows, (int, np.integer)) or not 1 <= rows <= sys.maxsize:
        raise ValueError(f"rows is {rows!r}, allowed: a whole number from 1")
    return _parts(_capture(path, topic, start, stop, fleet, robots), topic, int(rows), path)


def _capture(
    path: str | os.PathLike[str], topic: str, start: _Time | None, stop: _Time | None, fleet: str | None, robots: Any
) -> _native.CaptureRows:
    native, from_, to = lab("captures"), _time("start", start), _time("stop", stop)
    if from_ is not None and to is not None and type(from_) is type(to) and from_ > to:
        raise ValueError(f"start is {start}, after stop, which is {stop}")
    return native.CaptureRows(path, topic, fleet, robots, 0.0 if from_ is None else from_, to)


def _parts(
    capture: _native.CaptureRows, topic: str, rows: int, path: str | os.PathLike[str]
) -> Iterator[dict[str, np.ndarray]]:
    is_last = False
    while not is_last:
        part = capture.take(rows)
        is_last = part["ended"]
        if len(part["rows"]):
            yield _columns(_arrays(part, topic))
        if part["damage"] is not None:
            warnings.warn(f"{os.fspath(path)}: {part['damage']}", RecordingDamaged, stacklevel=2)


def _arrays(part: dict[str, Any], topic: str) -> dict[str, np.ndarray]:
    rows = part["bytes"].view(_ROWS[topic])
    found = {name: np.repeat(part[name], part["rows"]) for name in ("tick", "log_ns", "sent_ns")}
    return found | {name: rows[name] for name in rows.dtype.names}


def _time(name: str, given: _Time | None) -> int | float | None:
    """Unix ns as an integer, or an offset in seconds as a float."""
    allowed = "seconds after the capture's first message, a datetime with a time zone, or a numpy.datetime64 (UTC)"
    if given is None:
        return None
    if isinstance(given, datetime):
        if given.utcoffset() is None:
            raise ValueError(f"{name} is {given}, without a time zone, allowed: {allowed}")
        since = given - _EPOCH
        # Those of pandas have nanoseconds beside.
        unix_ns = ((since.days * 86_400 + since.seconds) * 1_000_000 + since.microseconds) * 1_000
        unix_ns += getattr(given, "nanosecond", 0)
    elif isinstance(given, np.datetime64):
        # Of 64 bits, which nanoseconds of distant years exceed.
        seconds = given.astype("datetime64[s]")
        if np.isnat(seconds) or not 0 <= int(seconds.astype(np.int64)) < 1 << 33:
            raise ValueError(f"{name} is {given}, allowed: {allowed}, from 1970 on")
        unix_ns = int(given.astype("datetime64[ns]").astype(np.int64))
    elif isinstance(given, (int, float, np.integer, np.floating)) and not isinstance(given, bool):
        if not 0.0 <= given <= _LONGEST_S:
            raise ValueError(f"{name} is {given}, allowed: {allowed} (numpy.datetime64(log_ns, 'ns'), of one of its times)")
        return float(given)
    else:
        raise TypeError(f"{name} is {given!r}, allowed: {allowed}")
    if not 0 <= unix_ns < 1 << 63:
        raise ValueError(f"{name} is {given}, allowed: {allowed}, from 1970 on")
    return unix_ns


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
    return _trials(lab("trials").read_trials(path, _reading(columns, current, accept)), os.fspath(path))


def _trials(found: list[tuple[str | None, dict[str, np.ndarray]]], name: str) -> list[Trial]:
    several = len(found) > 1
    return [Trial(columns, robot, f"{name} {robot}" if several else name) for robot, columns in found]


def _names(accept: Sequence[str]) -> list[str]:
    return [accept] if isinstance(accept, str) else list(accept)


def _reading(
    columns: dict[str, str] | None, current: str | None, accept: Sequence[str]
) -> tuple[list[str], str | None, list[str]]:
    mapped = [f"{quantity}={column}" for quantity, column in (columns or {}).items()]
    return mapped, current, _names(accept)
