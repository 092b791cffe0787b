"""Forecasts that learn online and intervals that hold, around any regressor and without a fleet.

    from joulebus import OnlineForecaster, Predictor        # needs scikit-learn

    forecaster = OnlineForecaster(Predictor("my.safetensors"))
    forecaster.update(features, readings_w, robots=7)       # forecasts before each reading, and their intervals
    power_w = forecaster.predict(next_features, robots=7)

The code of the worker's tick computes them: the same rows give the same bits.
"""
from __future__ import annotations

from typing import Any, Hashable

import numpy as np

from ._native import OnlineRobots
from ._optional import needed
from .predictor import Predictor

_base = needed("sklearn.base", "online forecasts")
_linear = needed("sklearn.linear_model", "online forecasts")
_validation = needed("sklearn.utils.validation", "online forecasts")

#: Readings that the autoregression looks back.
LAGS = 5
#: Share of the rows on which the residuals are measured, and the fewest rows that are divided so.
HELD_OUT, DIVIDED_FROM = 0.2, 20


class OnlineConformal(_base.RegressorMixin, _base.BaseEstimator):  # type: ignore[misc, name-defined]
    """Intervals around any regressor's forecasts that adapt to each robot's readings.

    Each end moves with every reading so that in the long run a share of `coverage` lies inside, whatever the residuals do.

    regressor:   any regressor of scikit-learn, or a `Predictor`, which needs no `fit`. The default is linear least squares
    coverage:    share of the readings inside, 0.5 to 0.99
    rate:        step of an end that a reading missed, as a share of its distance, 0.001 to 0.5
    resolution:  of the readings, in their unit. Residuals below it are not believed
    limits:      the least and the largest possible reading. Forecasts stay within
    longest_gap: successive missing readings that its own forecasts bridge, up to 65,535

    `fit(X, y)` fits a clone of the regressor, `regressor_`, and begins anew with all robots. `update(X, y)` takes rows with
    the readings that followed them, in the order of time. `predict(X)` and `predict_interval(X)` change nothing: each row
    is the next of its robot. `robots` is a label for all rows, or one for each. A robot is new when it is first named.

    It can be pickled, with everything learned about the robots.
    """

    _online = False

    def __init__(
        self,
        regressor: Any = None,
        *,
        coverage: float = 0.9,
        rate: float = 0.2,
        resolution: float = 0.01,
        limits: tuple[float, float] = (-np.inf, np.inf),
        longest_gap: int = 15,
    ) -> None:
        self.regressor = regressor
        self.coverage = coverage
        self.rate = rate
        self.resolution = resolution
        self.limits = limits
        self.longest_gap = longest_gap

    def fit(self, X: Any, y: Any, robots: Any = None) -> OnlineConformal:
        """Fits the regressor to rows `X` and the readings `y` that followed, and forgets all robots.

        Rows are in the order of time. The first interval comes from the last fifth of the rows,
        forecast after a fit to the others.
        """
        X, y = _validation.validate_data(self, X, y, y_numeric=True, ensure_all_finite=self._finite())
        labels = _labels(robots, len(X))
        wanted = self.regressor if self.regressor is not None else _linear.LinearRegression()
        self.regressor_ = _base.clone(wanted).fit(X, y)
        if isinstance(self.regressor_, Predictor):
            self._begin(self.regressor_)
            return self
        held_out = int(HELD_OUT * len(X)) if len(X) >= DIVIDED_FROM else 0
        first, apart = len(X) - held_out, self.regressor_
        if held_out > 0:
            apart = _base.clone(wanted).fit(X[:first], y[:first])
        else:
            first = 0
        residuals = y[first:] - apart.predict(X[first:])
        spread = [residuals.std(), *np.quantile(residuals, [0.05, 0.95])]
        lags, following = _successive(np.asarray(y, np.float64), labels)
        self._begin(([float(np.float32(part)) for part in spread], *_autoregression(lags, following), lags.tolist()))
        return self

    def predict(self, X: Any, robots: Any = None) -> np.ndarray:
        """The next reading of a robot if its row is one of `X`: float32, ``(rows,)``. Changes nothing."""
        return self._forecast(X, robots)[:, 0]

    def predict_interval(self, X: Any, robots: Any = None) -> np.ndarray:
        """Lower and upper end of the interval around each forecast of `predict`: float32, ``(rows, 2)``."""
        return self._forecast(X, robots)[:, 1:]

    def update(self, X: Any, y: Any, robots: Any = None, held: Any = False) -> np.ndarray:
        """Takes readings `y`, in the order of time, each with its row of `X`: what `predict` would have been given before.

        Returns ``(rows, 3)``: the forecast that was made before each reading, and the ends of its interval. A NaN in `y` is
        a missing reading. Rows with a NaN, or None in place of `X`, have no forecast and are not scored. `held` says of
        each reading, or of all, whether it repeats the last measurement.
        """
        self._ready()
        readings = np.asarray(y, np.float32)
        if readings.ndim != 1 or np.isinf(readings).any():
            raise ValueError(f"y has shape {readings.shape}, allowed: (rows,), without infinite readings")
        rows = len(readings)
        member = np.full(rows, np.nan, np.float32)
        if X is not None:
            X = _validation.validate_data(self, X, reset=False, ensure_all_finite="allow-nan", ensure_min_samples=0)
            if len(X) != rows:
                raise ValueError(f"X has {len(X)} rows, allowed are {rows}, one for each reading in y")
            whole = np.isfinite(X).all(axis=1) | (self._finite() == "allow-nan")
            if whole.any():
                member[whole] = self.regressor_.predict(X[whole])
        held = np.broadcast_to(np.asarray(held, np.bool_), (rows,))
        for label in _labels(robots, rows):
            if label not in self._slots:
                self._slots[label] = self._robots.add()
        return self._robots.read(self._places(robots, rows), member, readings, np.ascontiguousarray(held))

    def forget(self, robot: Hashable = 0) -> None:
        """Forgets a robot's readings: it begins anew."""
        self._ready()
        if robot not in self._slots:
            raise KeyError(f"there is no robot {robot!r}, it has no reading yet")
        self._robots.reset(self._slots[robot])

    def _forecast(self, X: Any, robots: Any) -> np.ndarray:
        self._ready()
        X = _validation.validate_data(self, X, reset=False, ensure_all_finite=self._finite())
        member = np.ascontiguousarray(self.regressor_.predict(X), np.float32)
        return self._robots.forecast(self._places(robots, len(X)), member)

    def _finite(self) -> Any:
        # A Predictor says itself which rows it cannot forecast: it does not read all columns.
        return "allow-nan" if isinstance(self.regressor, Predictor) else True

    def _ready(self) -> None:
        if not hasattr(self, "_robots") and isinstance(self.regressor, Predictor):
            # A Predictor is fitted from the beginning, and has the start of a robot on its card.
            self.regressor_ = self.regressor
            self._begin(self.regressor_)
        _validation.check_is_fitted(self)

    def _begin(self, start: Any) -> None:
        for name, number, least, most in [
            ("coverage", self.coverage, 0.5, 0.99),
            ("rate", self.rate, 0.001, 0.5),
            ("longest_gap", self.longest_gap, 0, 65535),
            ("resolution", self.resolution, 1e-6, 1e6),
        ]:
            if not least <= number <= most:
                raise ValueError(f"{name} is {number}, allowed are {least} to {most}")
        least, most = self.limits
        if not least < most:
            raise ValueError(f"limits are {self.limits}, allowed are two numbers, the smaller one first")
        gap = int(self.longest_gap)
        self._start, self._slots = start, {}
        self._robots = OnlineRobots(
            start, self._online, self.coverage, self.rate, self.resolution, (float(least), float(most)), gap
        )

    def _places(self, robots: Any, rows: int) -> np.ndarray:
        return np.array([self._slots.get(label, -1) for label in _labels(robots, rows)], np.int64)

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "_robots") or isinstance(self.regressor, Predictor)

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__().copy()
        if "_robots" in state:
            state["_robots"] = state["_robots"].to_bytes()
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        learned, slots = state.get("_robots"), state.get("_slots")
        super().__setstate__(state)
        if learned is not None:
            self._begin(self._start)
            self._robots.restore(learned)
            self._slots = slots


class OnlineForecaster(OnlineConformal):
    """Forecasts that learn from each robot's own readings, with intervals that adapt.

    Its members are the regressor, the robot's last reading, and two stacks of these, the robot's
    mean and an autoregression. Their weights follow from their errors so far. So the forecast is
    never much worse than the best member, even on a robot that the member does not know
    (docs/measured/online.md). Until a robot has five readings, it is the regressor's own.

    Arguments and methods are those of `OnlineConformal`. With ``regressor=Predictor(file)``, and with the platform's
    `resolution` and `limits`, forecasts and intervals have the bits of a worker with that model.
    """

    _online = True

    def weights(self, robot: Hashable = 0) -> np.ndarray:
        """Weights of the last reading, the regressor and the stacks in a robot's next forecast, with sum 1."""
        self._ready()
        if robot not in self._slots:
            raise KeyError(f"there is no robot {robot!r}, it has no reading yet")
        return np.array(self._robots.weights(self._slots[robot]), np.float32)


def _labels(robots: Any, rows: int) -> list[Hashable]:
    """One label for each row."""
    found = np.asarray(0 if robots is None else robots)
    if found.shape not in ((), (rows,)):
        raise ValueError(f"robots has shape {found.shape}, allowed: () or ({rows},)")
    return np.broadcast_to(found, (rows,)).tolist()


def _successive(readings: np.ndarray, labels: list[Hashable]) -> tuple[np.ndarray, np.ndarray]:
    """Five successive readings of a robot, newest first, and the one that followed."""
    lags, following = [], []
    _, robots = np.unique(np.array(labels), return_inverse=True)
    for robot in range(robots.max(initial=-1) + 1):
        own = readings[robots == robot]
        count = len(own) - LAGS
        if count > 0:
            lags.append(np.stack([own[LAGS - 1 - lag : LAGS - 1 - lag + count] for lag in range(LAGS)], axis=1))
            following.append(own[LAGS:])
    if not lags:
        return np.full((1, LAGS), readings.mean()), readings[-1:]
    return np.concatenate(lags), np.concatenate(following)


def _autoregression(lags: np.ndarray, following: np.ndarray) -> tuple[float, list[float]]:
    """Bias and weights by least squares, or the last reading where there are too few."""
    if len(lags) <= 2 * LAGS:
        return 0.0, [1.0, 0.0, 0.0, 0.0, 0.0]
    level = lags.mean()
    found = np.linalg.lstsq(np.column_stack([np.ones(len(lags)), lags - level]), following - level, rcond=1e-9)[0]
    return float(level + found[0] - level * found[1:].sum()), found[1:].tolist()
