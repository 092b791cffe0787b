"""The network on arrays, with the methods of a scikit-learn regressor."""
from __future__ import annotations

from typing import Any, Callable

import numpy as np

from . import _native
from ._optional import lab

#: Shares of the rows given to `fit`, in their order: the rest trains.
VALIDATION = 0.1
HELD_OUT = 0.1


class Predictor(_native.Predictor):
    """Forecasts the power of any number of robots at once, in SI units.

    model:       a joulebus model file (.safetensors), or ``builtin:NAME``
    feature_set: what `fit` trains on: ``full`` (the paper's 11 features), ``power_only``, and both with the age of
                 the newest reading, ``freshness`` and ``power_freshness`` (13)
    seed, max_epochs, patience: of `fit`, by the paper's recipe. The same seed gives the same bytes

    ``predict(features)`` takes rows ``(robots, 11)`` in the order of the first 11 ``joulebus.FEATURE_NAMES``: v, omega,
    their derivatives, their magnitudes, and the last five readings, newest first, in m, rad, s, W. A model with the age
    of the newest reading takes rows of 13. The result is the readings expected next, W, float32. A NaN in a row makes
    that row's forecast NaN and changes no other.

    ``rollout(v, omega)`` takes command sequences ``(steps,)``, ``(robots, steps)`` or ``(robots, candidates, steps)``
    in m/s and rad/s, and returns the energy of each in J and the power of each step in W. ``readings_w`` are the
    readings before, W: one number, one for each robot, or five, newest first. The default is 3.5. ``before`` is the
    command before, and ``step_s`` the time between two steps.

    The bits are those of joulebus itself. Other Python threads run meanwhile, and may use the same object.
    """

    def __init__(
        self,
        model: str = "builtin:gternal-sim",
        *,
        feature_set: str = "full",
        seed: int = 0,
        max_epochs: int = 100,
        patience: int = 10,
    ) -> None:
        # The model itself is opened by `__new__`, in Rust.
        self.model = model
        self.feature_set = feature_set
        self.seed = seed
        self.max_epochs = max_epochs
        self.patience = patience

    def fit(self, X: Any, y: Any, *, progress: Callable[..., Any] | None = None) -> Predictor:
        """Trains a network on rows of features `X` and the readings that followed, `y` in W.

        Rows are in the order of time: the last tenth is held out for the model's scores, the tenth before ends the
        training. `progress`, if given, is called after each epoch with its number, the training loss, the validation
        loss and whether it is the best so far. Ctrl-C ends the training and leaves the model as it was.
        """
        rows = len(X)
        validation, held_out = int(rows * VALIDATION), int(rows * HELD_OUT)
        trained, epochs = lab("trainings").train_rows(
            X,
            y,
            (rows - validation - held_out, validation),
            name="fitted",
            feature_set=self.feature_set,
            seed=self.seed,
            max_epochs=self.max_epochs,
            patience=self.patience,
            progress=progress,
        )
        self._load(trained)
        self.epochs_ = epochs
        return self

    def score(self, X: Any, y: Any) -> float:
        """R² of the forecasts of rows `X` against the readings `y`, W."""
        expected = np.asarray(y, np.float64)
        errors = expected - np.asarray(self.predict(X), np.float64)
        if errors.shape != expected.shape:
            raise ValueError(f"y has shape {expected.shape}, allowed: {errors.shape[:1]}, one reading for each row")
        spread = np.sum((expected - expected.mean()) ** 2)
        return float(1.0 - np.sum(errors**2) / spread) if spread > 0.0 else float("nan")

    def save(self, path: str) -> None:
        """Writes the model file (.safetensors), which the worker, `joulebus eval` and all others read."""
        with open(path, "wb") as file:
            file.write(self.to_bytes())

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The arguments of the constructor, as scikit-learn asks for them."""
        return {name: getattr(self, name) for name in ("model", "feature_set", "seed", "max_epochs", "patience")}

    def set_params(self, **params: Any) -> Predictor:
        """Sets arguments of the constructor. Another `model` is opened at once."""
        allowed = self.get_params()
        for name in params:
            if name not in allowed:
                raise ValueError(f"there is no parameter {name}, allowed are {', '.join(allowed)}")
        if "model" in params:
            self._load(_native.Predictor(params["model"]).to_bytes())
        for name, value in params.items():
            setattr(self, name, value)
        return self

    def __sklearn_tags__(self) -> Any:
        # What scikit-learn asks an estimator for from 1.6 on, and refuses it without. Only
        # scikit-learn calls it.
        from sklearn.utils import RegressorTags, Tags, TargetTags

        return Tags(estimator_type="regressor", target_tags=TargetTags(required=True), regressor_tags=RegressorTags())

    def __sklearn_is_fitted__(self) -> bool:
        # It has a model from the beginning.
        return True

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.get_params(), self.to_bytes(), getattr(self, "epochs_", None))

    def __repr__(self) -> str:
        return f"Predictor({self.name!r}, hash={self.hash})"


def _restored(kind: type, params: dict[str, Any], contents: bytes, epochs: Any) -> Predictor:
    # The file that `model` names may no longer be there, or hold another model.
    restored = kind.__new__(kind)
    restored._load(contents)
    for name, value in params.items():
        setattr(restored, name, value)
    if epochs is not None:
        restored.epochs_ = epochs
    return restored
