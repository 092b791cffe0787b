"""Answers to questions about plans: what they cost, and whether the robot's battery suffices."""
from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Iterator

import numpy as np

from ._optional import needed


@dataclass(frozen=True)
class Answer:
    """The answer to one candidate, or of one robot. What is unknown is None.

    ``verdict`` is ``yes``, ``tight``, ``no``, or ``unknown`` with its ``reason``. It is ``yes``
    only if on every leg the upper end of the energy is below the lower bound of the battery's
    energy above the reserve, and the robot's state is known. ``energy_lo_j`` and ``energy_hi_j``
    are the interval at the asked coverage. ``left_lo_j`` is the lower bound of the energy left.
    ``margin_j`` is a bound: the lower bound of the energy above the reserve, less ``energy_hi_j``.
    ``probability`` is that of finishing above the reserve, where the model's errors cover the plan.
    ``limiting_leg`` is the first leg that is not a yes, from 0. ``turn_back_s`` is the latest time
    to turn back. A yes has none: the robot can drive the whole path. ``alarms`` names the alarms
    that cast doubt on the robot's readings, such as ``StuckSensor``. ``caveats`` has what weakens
    the answer, the alarms too.
    """

    robot: int
    verdict: str
    reason: str | None
    duration_s: float
    energy_j: float | None
    energy_lo_j: float | None
    energy_hi_j: float | None
    left_j: float | None
    left_lo_j: float | None
    margin_j: float | None
    probability: float | None
    limiting_leg: int | None
    turn_back_s: float | None
    alarms: str | None
    caveats: str | None


#: Columns of answers.
_COLUMNS = tuple(field.name for field in fields(Answer))
_TEXTS = ("verdict", "reason", "alarms", "caveats")


class Answers:
    """Answers to one question, as of one tick (``tick``, ``age_s`` old when it was answered).

    Each field of `Answer` is an array here. Unknown values are NaN (−1 as ``limiting_leg``, None as
    a text). There is one element for each candidate, in the order of the candidates, or for each
    robot. If robots follow a path, the best robot is first. ``power_w``, if it was asked for, is
    the power of every step, W: ``(candidates, steps)``. ``along``, if moments were asked for, has
    the answers to the parts of the trip up to each moment.
    """

    def __init__(self, told: dict[str, Any]) -> None:
        self.tick: int = told["tick"]
        self.age_s: float = told["age_s"]
        self.power_w: np.ndarray | None = told.get("power_w")
        along = told.get("along")
        self.along: Answers | None = along and Answers({**along, "tick": self.tick, "age_s": self.age_s})
        for name in _COLUMNS:
            column = told[name]
            setattr(self, name, np.array(column, object if name != "verdict" else "U7") if name in _TEXTS else column)

    def __len__(self) -> int:
        return len(self.robot)

    def __getitem__(self, at: int) -> Answer:
        """The answer to candidate `at`, or of the robot at this place."""
        found = {name: _known(name, getattr(self, name)[at]) for name in _COLUMNS}
        return Answer(**found)

    def __iter__(self) -> Iterator[Answer]:
        return (self[at] for at in range(len(self)))

    @property
    def best(self) -> int:
        """Index of the best answer: by verdict (yes, tight, no, unknown), those without alarms on
        the readings first, then by the expected energy."""
        ranks = {"yes": 0, "tight": 1, "no": 2, "unknown": 3}
        rank = np.array([ranks[verdict] for verdict in self.verdict])
        doubted = np.array([alarms is not None for alarms in self.alarms])
        return int(np.lexsort((np.nan_to_num(self.energy_j, nan=np.inf), doubted, rank))[0])

    def to_pandas(self) -> Any:
        """A DataFrame with one row for each answer. Needs pandas."""
        return needed("pandas", "data frames").DataFrame({name: getattr(self, name) for name in _COLUMNS})

    def __repr__(self) -> str:
        counts = {verdict: int(np.sum(self.verdict == verdict)) for verdict in ("yes", "tight", "no", "unknown")}
        return f"Answers({len(self)}, {', '.join(f'{verdict}: {count}' for verdict, count in counts.items() if count)})"


def _known(name: str, value: Any) -> Any:
    """A number of Python. None for what is unknown."""
    if name in _TEXTS:
        return None if value is None else str(value)
    value = value.item()
    return None if value != value or (name == "limiting_leg" and value < 0) else value
