"""The network as arrays and a function of them: for NumPy, JAX and PyTorch."""
from __future__ import annotations

import importlib
import io
import json
import math
from typing import Any, Callable

import numpy as np

from ._native import Predictor
from ._optional import lab

_LAYERS = 4
#: The first feature that a network of so many inputs reads.
_FIRST = {11: 0, 13: 0, 5: 6, 7: 6}


def arrays(model: Any = "builtin:gternal-sim", xp: Any = np) -> dict[str, Any]:
    """The numbers of a network: float32 arrays of the module `xp` (numpy, jax.numpy, torch) by name.

    ``layers.0.weight`` to ``layers.3.bias``, and the normalisation: ``feature_mean``, ``feature_std``, ``power_mean_w``,
    ``power_std_w``. `model` is a `Predictor`, a model file, or ``builtin:NAME``. A dict of arrays is a pytree of JAX. With
    torch, each can be made a parameter.
    """
    found, _ = _contents(model)
    names = [f"layers.{number}.{part}" for number in range(_LAYERS) for part in ("weight", "bias")]
    names += ["feature_mean", "feature_std", "power_mean_w", "power_std_w"]
    return {name: xp.asarray(np.array(found[name], np.float32)) for name in names}


def forward(model: Any = "builtin:gternal-sim", xp: Any = np) -> Callable[[dict[str, Any], Any], Any]:
    """The network as a function ``f(arrays, features)`` of `arrays` and of rows ``(…, 11)`` in SI units, in the order of
    ``joulebus.FEATURE_NAMES``. It returns the readings expected next, W, ``(…,)``.

    `xp` is the module that computes: numpy, jax.numpy or torch. It can be differentiated, compiled and trained further
    there. Forecasts are those of `Predictor.predict` within 1e-5 of the power's scale. Networks that read the age of
    readings take rows of 13.
    """
    found, metadata = _contents(model)
    inputs = found["feature_mean"].shape[0]
    first = _FIRST[inputs]
    activation = _activation(metadata, xp)

    def forecast_w(params: dict[str, Any], features: Any) -> Any:
        values = (features[..., first : first + inputs] - params["feature_mean"]) / params["feature_std"]
        for number in range(_LAYERS):
            values = values @ params[f"layers.{number}.weight"].T + params[f"layers.{number}.bias"]
            if number < _LAYERS - 1:
                values = activation(values)
        return values[..., 0] * params["power_std_w"] + params["power_mean_w"]

    return forecast_w


def _contents(model: Any) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    predictor = model if isinstance(model, Predictor) else Predictor(model)
    lab("arrays of a network")
    found = {name: np.load(io.BytesIO(contents), allow_pickle=False) for name, contents in predictor._arrays()}
    metadata = found.pop("metadata")
    return found, json.loads(metadata.item().decode())


def _activation(metadata: dict[str, Any], xp: Any) -> Callable[[Any], Any]:
    name = metadata["activation"]
    if name == "relu":
        return lambda values: values * (values > 0)
    if name == "gelu_tanh":
        scale = math.sqrt(2.0 / math.pi)
        return lambda values: 0.5 * values * (1.0 + xp.tanh(scale * (values + 0.044715 * values**3)))
    erf = _erf(xp)
    return lambda values: 0.5 * values * (1.0 + erf(values * math.sqrt(0.5)))


def _erf(xp: Any) -> Callable[[Any], Any]:
    name = xp.__name__
    if name == "numpy":
        # NumPy has none.
        each = np.frompyfunc(math.erf, 1, 1)
        return lambda values: np.asarray(each(values)).astype(values.dtype)
    if name == "jax.numpy":
        return importlib.import_module("jax.scipy.special").erf
    if hasattr(xp, "erf"):
        return xp.erf
    raise TypeError(f"{name} has no function erf, allowed are numpy, jax.numpy and torch")
