"""The network as arrays and a function has the forecasts of the network itself, in NumPy, JAX and PyTorch."""
from __future__ import annotations

import importlib

import joulebus
import numpy as np
import pytest
from conftest import model_file, rows

#: Numbers of weights and biases. The paper's network has 7,041.
WEIGHTS = {"gternal-sim": 7041, "gternal-sim-power": 6657, "gternal-sim-freshness": 7169}
#: Scale of the forecasts, W.
SCALE_W = 5.0


def imported(name: str):
    # torch is large: tested where it is installed.
    if name == "torch":
        return pytest.importorskip("torch")
    return importlib.import_module(name)


@pytest.mark.parametrize(
    "module, name",
    # JAX takes seconds to compile each shape.
    [("jax.numpy", "gternal-sim"), *((module, name) for module in ("numpy", "torch") for name in WEIGHTS)],
)
def test_forecasts_are_those_of_the_network(module, name):
    xp = imported(module)
    predictor = joulebus.Predictor(str(model_file(name)))
    inputs = rows(200, width=13 if "freshness" in name else 11)
    params, forward = joulebus.arrays(predictor, xp), joulebus.forward(predictor, xp)
    found_w = np.asarray(forward(params, xp.asarray(inputs)))
    assert found_w.shape == (200,) and np.abs(found_w - predictor.predict(inputs)).max() <= 1e-5 * SCALE_W
    # Any leading dimensions.
    again_w = np.asarray(forward(params, xp.asarray(inputs.reshape(4, 50, -1))))
    assert np.allclose(again_w.reshape(-1), found_w, atol=1e-5 * SCALE_W)
    assert sum(np.asarray(array).size for key, array in params.items() if key.startswith("layers")) == WEIGHTS[name]


def test_jax_compiles_and_differentiates_it():
    import jax

    params, forward = joulebus.arrays(xp=jax.numpy), joulebus.forward(xp=jax.numpy)
    inputs = jax.numpy.asarray(rows(16))
    expected_w = joulebus.Predictor().predict(rows(16))
    assert np.abs(np.asarray(jax.jit(forward)(params, inputs)) - expected_w).max() <= 1e-5 * SCALE_W
    slope = np.asarray(jax.grad(lambda features: forward(params, features).sum())(inputs))
    # Of the newest reading, beside differences.
    step = np.zeros((1, 11), np.float32)
    step[0, 6] = 1e-2
    differences = (joulebus.Predictor().predict(rows(16) + step) - joulebus.Predictor().predict(rows(16) - step)) / 2e-2
    assert np.abs(slope[:, 6] - differences).max() < 0.02
    losses = jax.grad(lambda params: ((forward(params, inputs) - 4.0) ** 2).mean())(params)
    assert set(losses) == set(params) and np.isfinite(np.asarray(losses["layers.0.weight"])).all()


def test_a_module_that_cannot_compute_it_is_refused():
    with pytest.raises(TypeError, match="math has no function|asarray|allowed are numpy, jax.numpy and torch"):
        joulebus.forward(xp=importlib.import_module("random"))
    with pytest.raises(joulebus.ModelError, match="no built-in model"):
        joulebus.arrays("builtin:none")
