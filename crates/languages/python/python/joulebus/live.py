"""A fleet live: forecasts read in shared memory, and samples sent to its worker."""
from __future__ import annotations

import atexit
import os
import threading
import time
import weakref
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Iterator, Mapping, NamedTuple

import numpy as np

from . import _native
from ._optional import needed
from .questions import Answers


def _dtype(layout: tuple[list[tuple[str, str, int]], int]) -> np.dtype:
    fields, size = layout
    names, formats, offsets = (list(column) for column in zip(*fields))
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


#: NumPy's types of a row of forecasts, diagnostics, budgets and outlooks: names and units as in
#: `joulebus-wire`.
FORECAST = _dtype(_native.FORECAST)
DIAGNOSTIC = _dtype(_native.DIAGNOSTIC)
BUDGET = _dtype(_native.BUDGET)
OUTLOOK = _dtype(_native.OUTLOOK)
#: Horizons of an outlook, s: the columns of its `energy_j`, `energy_lo_j` and `energy_hi_j`.
OUTLOOK_S: tuple[float, ...] = _native.OUTLOOK_S

# Bits of a forecast's flags.
_POWER, _INTERVAL, _READING = 1, 2, 4


@dataclass(frozen=True)
class Gone:
    """The worker has ended: ``how`` is ``ended``, ``exited``, ``found dead`` or ``unreachable``. Do not rely on forecasts."""

    how: str


@dataclass(frozen=True)
class Stale:
    """The newest frame is older than two tick periods. Do not rely on it."""

    age_s: float


class Forecast:
    """One robot's forecast, in its frame. What is unknown is None."""

    __slots__ = ("row",)

    def __init__(self, row: np.void) -> None:
        self.row = row

    @property
    def robot(self) -> int:
        """Id of the robot."""
        return int(self.row["robot"])

    @property
    def expected_w(self) -> float | None:
        """Power expected at ``target_ns``, W. The field ``row["power_w"]`` is NaN where this is None."""
        return float(self.row["power_w"]) if self.row["flags"] & _POWER else None

    @property
    def interval_w(self) -> tuple[float, float] | None:
        """Lower and upper end of the interval, W."""
        row = self.row
        return (float(row["lo_w"]), float(row["hi_w"])) if row["flags"] & _INTERVAL else None

    @property
    def last_reading_w(self) -> float | None:
        """The last accepted reading, W. The field ``row["reading_w"]`` is NaN where this is None."""
        return float(self.row["reading_w"]) if self.row["flags"] & _READING else None

    @property
    def quality(self) -> str:
        """``Fresh``, ``Held``, ``Warmup``, ``OpenLoop``, ``Invalid`` or ``Unknown``."""
        return self._quality()[0]

    @property
    def quality_detail(self) -> int | str | None:
        """Readings so far (Warmup), steps (OpenLoop) or the reason (Invalid)."""
        return self._quality()[1]

    @property
    def target_ns(self) -> int:
        """Stamp for which the reading is forecast, monotonic ns (``time.monotonic_ns``)."""
        return int(self.row["target_ns"])

    def _quality(self) -> tuple[str, Any]:
        return _native.quality(int(self.row["quality"]), int(self.row["quality_detail"]))

    def __repr__(self) -> str:
        return f"Forecast(robot={self.robot}, expected_w={self.expected_w}, interval_w={self.interval_w}, quality={self.quality})"


class Frame:
    """Forecasts of all robots, as the worker wrote them into shared memory.

    ``rows`` is a read-only array of `joulebus.FORECAST` on that memory, and ``power_w``, ``lo_w``,
    ``hi_w``, ``robot`` and every other field of it a view of a column. Nothing is copied. A frame,
    and each array made of it, keeps the memory for as long as it exists, also after the planner was
    closed. A closed planner keeps its place (``readers.max_planners``) until then. You can keep two
    frames beside the newest. If you keep more, the next read is refused. ``rows.copy()`` is a copy
    of your own.

    ``frame[7]`` is the forecast of robot 7.
    """

    def __init__(self, memory: _native.FrameMemory, positions: dict[int, int]) -> None:
        self._memory = memory
        self._positions = positions
        self._header = memory.header
        self.rows: np.ndarray = np.asarray(memory)

    def __getattr__(self, name: str) -> Any:
        # Only for names that are no attribute: columns, and fields of the header.
        if name.startswith("_"):
            raise AttributeError(name)
        if name in FORECAST.fields:
            return self.rows[name]
        if name in self._header:
            return self._header[name]
        raise AttributeError(f"a frame has no {name}. It has {', '.join([*FORECAST.names, *self._header])}")

    @property
    def age_s(self) -> float:
        """Time since it was sent, s."""
        return 1e-9 * (time.monotonic_ns() - self._header["sent_ns"])

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Forecast]:
        return map(Forecast, self.rows)

    def __contains__(self, robot: object) -> bool:
        return isinstance(robot, (int, np.integer)) and self._position(int(robot)) is not None

    def __getitem__(self, robot: int) -> Forecast:
        position = self._position(int(robot))
        if position is None:
            raise KeyError(f"robot {robot} is not in the frame, which has {len(self)} robots")
        return Forecast(self.rows[position])

    def to_pandas(self) -> Any:
        """A copy as a DataFrame, indexed by robot. Unknown values are NaN. Needs pandas."""
        return _data_frame(self.rows)

    def _position(self, robot: int) -> int | None:
        # Positions change only when robots join or leave.
        found, ids = self._positions.get(robot), self.rows["robot"]
        if found is not None and found < len(ids) and ids[found] == robot:
            return found
        self._positions.clear()
        self._positions.update(zip(ids.tolist(), range(len(ids))))
        return self._positions.get(robot)

    def __repr__(self) -> str:
        return f"Frame(tick={self._header['tick']}, robots={len(self)})"


class Table:
    """Diagnostics, budgets or outlooks of all robots as of one tick: a copy. ``rows`` and columns as in a `Frame`."""

    def __init__(self, tick: int, rows: np.ndarray) -> None:
        self.tick = tick
        self.rows = rows
        self._positions: dict[int, int] | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "rows":
            raise AttributeError(name)
        if name in self.rows.dtype.fields:
            return self.rows[name]
        raise AttributeError(f"there is no {name}. There are tick, {', '.join(self.rows.dtype.names)}")

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, robot: int) -> np.void:
        if self._positions is None:
            self._positions = {int(robot): position for position, robot in enumerate(self.rows["robot"])}
        if robot not in self._positions:
            raise KeyError(f"robot {robot} is not in the table, which has {len(self)} robots")
        return self.rows[self._positions[robot]]

    def to_pandas(self) -> Any:
        """A DataFrame, indexed by robot. Needs pandas."""
        return _data_frame(self.rows)

    def __repr__(self) -> str:
        return f"Table(tick={self.tick}, robots={len(self)})"


class _Connection:
    """What planners and publishers share: closing, at the end of the interpreter at the latest."""

    _ports: Any

    def close(self) -> None:
        """Leaves the fleet. Further use is refused. Closing again does nothing."""
        ports, _open = self._ports, _CONNECTIONS
        _open.discard(self)
        ports.close()

    def __enter__(self) -> Any:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


_CONNECTIONS: weakref.WeakSet[_Connection] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    for connection in list(_CONNECTIONS):
        # In a child made by `fork` they are the parent's.
        if connection._pid == os.getpid():
            connection.close()


class Planner(_Connection):
    """A program that plans: reads a fleet's forecasts, diagnostics, budgets and outlooks, and asks about plans.

    The worker may start later, end and be restarted.

        with joulebus.Planner("configs/fleet.toml") as planner:
            for event in planner.events(timeout=5.0):
                if isinstance(event, joulebus.Frame):
                    print(event[7].interval_w, event.power_w.sum())

    Several threads may use one planner. Only one call runs at a time. A child made by `fork` cannot
    use its parent's planner: open a new one there.
    """

    def __init__(self, config: str | os.PathLike[str], name: str = "planner") -> None:
        self._ports = _native.PlannerPorts(config, name)
        self._positions: dict[int, int] = {}
        self._asking: _native.QuestionPorts | None = None
        self._lock = threading.Lock()
        # A later change of the working directory must not change the file.
        self._joined = (os.path.abspath(config), name)
        self._pid = os.getpid()
        _CONNECTIONS.add(self)

    def next(self, timeout: float | None = None) -> Frame | Gone | Stale | None:
        """The next event. None if there is none within `timeout` seconds. Of several frames it is the newest."""
        told = self._ports.wait(timeout)
        if isinstance(told, _native.FrameMemory):
            return Frame(told, self._positions)
        if told is None:
            return None
        what, detail = told
        return Gone(detail) if what == "gone" else Stale(detail)

    def events(self, timeout: float | None = None) -> Iterator[Frame | Gone | Stale]:
        """Events as they come: frames, the worker's end, stale frames. Ends when none has come for
        `timeout` seconds. Without a timeout it never ends."""
        while True:
            event = self.next(timeout)
            if event is None:
                return
            yield event
            # A frame is kept no longer than its user keeps it.
            del event

    def diagnostics(self, timeout: float | None = 1.0) -> Table | None:
        """The newest diagnostics: residuals, alarms, coverage (`joulebus.DIAGNOSTIC`). The first
        call opens the service, and waits for its next frame. None if there is none within `timeout`
        seconds."""
        return _table(self._ports.diagnostics(timeout), DIAGNOSTIC)

    def budgets(self, timeout: float | None = 1.0) -> Table | None:
        """The newest budgets: energy drawn and left, state of charge (`joulebus.BUDGET`). None if there is none
        within `timeout` seconds."""
        return _table(self._ports.budgets(timeout), BUDGET)

    def outlooks(self, timeout: float | None = 1.0) -> Table | None:
        """The newest outlooks (`joulebus.OUTLOOK`): the energy that each robot will draw over
        `joulebus.OUTLOOK_S` if it goes on as now, and its time to empty, with bounds. The first
        call opens the service. From then on the worker computes outlooks. None if there is none
        within `timeout` seconds."""
        return _table(self._ports.outlooks(timeout), OUTLOOK)

    def what_if(
        self,
        robot: int,
        v: Any,
        omega: Any,
        *,
        period_s: float | None = None,
        coverage: float = 0.9,
        power: bool = False,
        timeout: float = 1.0,
    ) -> Answers:
        """What command sequences would cost a robot: `v` in m/s and `omega` in rad/s, ``(steps,)`` or ``(candidates,
        steps)``, each command in force for `period_s` (the fleet's tick by default).

        This process computes the answers from the newest tick. Meanwhile other Python threads run.
        `coverage` is that of the intervals, 0.5 to 0.999. `power` asks for the power of every step
        too. If no current frame arrives within `timeout` seconds, the answers are unknown and say
        so. If no frame has arrived at all, `ReadError` is raised. The first question joins the
        fleet once more, as a planner for which the worker writes plan states.
        """
        return Answers(self._asked().what_if([robot], v, omega, period_s, coverage, power, timeout))

    def ask(
        self,
        robots: Any,
        path: Any = None,
        *,
        idle_s: float | None = None,
        speed: Any = float("inf"),
        heading: float | None = None,
        back_to: tuple[float, float] | None = None,
        dwell: Any = None,
        load: Any = None,
        times: Any = None,
        tolerance: float | None = None,
        coverage: float = 0.9,
        power: bool = False,
        moments: int = 0,
        timeout: float = 1.0,
    ) -> Answers:
        """What a path, or `idle_s` seconds at rest, cost one robot or several, and whether their
        batteries suffice.

        `path` has points ``(points, 2)`` in m. The robot is at the first one. Only its shape
        counts, not how many points describe it. `speed` (m/s) is one number, or one towards each
        point. ``ValueError`` if one is above the platform's. Infinity, the default, is the highest
        speed that the model was trained on. `heading` (rad) is that at the first point. With
        `back_to` the path back counts too, and ``turn_back_s`` is the latest time to turn back
        unless the answer is a yes. The best robot is first. `power` and `moments` are possible for
        one robot only.

        Each point may have a `dwell` (s, the robot waits there), a `load` (W, drawn in addition on
        the way there and while it waits) and a time in `times` (s, when it is there; speeds are
        then upper limits, and ``caveats`` says if the robot is more than a second late). Corners
        are cut within `tolerance` (m). Without it the stairs of a grid are, within half a cell.
        With `moments`, ``along`` has the answers to the parts of the trip up to so many evenly
        spaced moments.
        """
        if (path is None) == (idle_s is None):
            raise ValueError("ask takes either a path or idle_s")
        ids, asked = np.atleast_1d(np.asarray(robots)), self._asked()
        if path is None:
            of_path = (back_to, heading, dwell, load, times, tolerance)
            if power or any(value is not None for value in of_path):
                raise ValueError(
                    "power, back_to, heading, dwell, load, times and tolerance are of a path"
                )
            return Answers(asked.idle(ids, idle_s, coverage, moments, timeout))
        columns, more = [dwell, load, times], (heading, tolerance)
        return Answers(
            asked.follow(ids, path, speed, columns, more, back_to, coverage, power, moments, timeout)
        )

    def acknowledge(
        self, robot: int, alarm: str, by: str, *, new_normal: bool = False, timeout: float = 5.0
    ) -> None:
        """Acknowledges a raised alarm in the name of the person `by`, until the alarm ends.
        Everybody sees who acknowledged it, and when. With `new_normal` a ``LevelHigh`` or
        ``LevelLow`` ends: from now on the robot is compared with its present power.

        ``RuntimeError`` if the alarm is not raised or cannot be the new normal, or no worker takes
        it within `timeout` seconds. A new normal is taken after a quarter of a second at the
        earliest. If `timeout` ends before, the alarm is acknowledged, and does not end.
        """
        self._ports.check()
        _native.acknowledge(self._joined, robot, alarm, by, new_normal, timeout)

    def state_battery(
        self,
        robot: int,
        by: str,
        *,
        charge: float | None = None,
        full: bool = False,
        exchanged: bool = False,
        timeout: float = 5.0,
    ) -> None:
        """States a robot's battery in the name of the person `by`: its measured `charge` (0 to 1), that
        it is `full`, or that it was `exchanged`. The worker's next tick takes it.

        ``RuntimeError`` if the robot has no battery, or no worker takes it within `timeout` seconds.
        """
        self._ports.check()
        _native.state_battery(self._joined, robot, charge, full, exchanged, by, timeout)

    def close(self) -> None:
        """Leaves the fleet. Further use is refused. Closing again does nothing."""
        super().close()
        asking = self._asking
        if asking is not None:
            asking.close()

    def _asked(self) -> _native.QuestionPorts:
        # The ports know whether the planner is open, and this process its own.
        self._ports.check()
        with self._lock:
            if self._asking is None:
                config, name = self._joined
                self._asking = _native.QuestionPorts(config, name)
            return self._asking

    @property
    def status(self) -> Mapping[str, Any]:
        """The worker (waiting, alive, stale, gone), and what was counted: frames, gaps, ticks missed, runs of the
        worker, connections that failed, frames of others, frames in use."""
        return self._ports.status()


class Refusal(NamedTuple):
    """Samples that the worker has refused: reason, number, robot of the last one, and what to do."""

    reason: str
    count: int
    robot: int
    text: str


class Publisher(_Connection):
    """Sends what a fleet controller commanded and measured, one frame for all robots per control tick.

        with joulebus.Publisher("configs/fleet.toml", "fleet-controller") as publisher:
            publisher.publish(ids, v=v_mps, omega=omega_radps, power=power_w)
    """

    def __init__(self, config: str | os.PathLike[str], name: str = "controller") -> None:
        self._ports = _native.PublisherPort(config, name)
        self._pid = os.getpid()
        _CONNECTIONS.add(self)

    def publish(self, ids: Any, *, intended_ns: int | None = None, **columns: Any) -> int:
        """Sends one frame and returns the number of processes that read it: 0 means that no worker runs.

        ids: ids of robots, each once. Columns have one element for each robot, or one number for all. A NaN, or no
        column, means unknown. `intended_ns`: when the frame was due (`time.monotonic_ns`).
        """
        readers, _, _ = self._ports.publish(ids, columns, intended_ns)
        return readers

    def refusals(self) -> list[Refusal]:
        """Samples of this run that the worker has refused, by reason, the most frequent first. `publish` warns once
        of each reason. Empty without a worker on this host."""
        return [Refusal(*found) for found in self._ports.refusals()]

    @property
    def frames_sent(self) -> int:
        """Frames sent in this run."""
        return self._ports.counts()[0]

    @property
    def samples_sent(self) -> int:
        """Samples sent in this run."""
        return self._ports.counts()[1]

    @property
    def capacity(self) -> int:
        """Most samples in a frame."""
        return self._ports.counts()[2]


_LISTED = "".join(f"\n        - {name}: {doc}" for name, doc in _native.PUBLISHED_COLUMNS)
Publisher.publish.__doc__ = f"{Publisher.publish.__doc__}\n        The columns:\n{_LISTED}\n"


def _table(found: tuple[int, bytes] | None, dtype: np.dtype) -> Table | None:
    if found is None:
        return None
    tick, contents = found
    return Table(tick, np.frombuffer(contents, dtype))


def _data_frame(rows: np.ndarray) -> Any:
    pandas = needed("pandas", "data frames")
    return pandas.DataFrame(_columns({name: rows[name] for name in rows.dtype.names})).set_index("robot")


def _columns(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Copies, one for each horizon of an outlook's energy (``energy_j_10s``), or element (``charge_rate_0``)."""
    columns = {}
    for name, values in found.items():
        if values.ndim == 1:
            columns[name] = values.copy()
        else:
            horizons = [f"{seconds:g}s" for seconds in OUTLOOK_S]
            of = horizons if values.shape[1] == len(horizons) else range(values.shape[1])
            columns |= {f"{name}_{element}": values[:, place].copy() for place, element in enumerate(of)}
    return columns
