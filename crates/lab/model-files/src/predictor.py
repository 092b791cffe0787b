"""Forecasts of a robot's power, by the joulebus model @NAME@, hash @HASH@.

One file that needs NumPy only, written by `joulebus model export`. It has the model inside.

    from predictor import EnergyPredictor

    predictor = EnergyPredictor()
    predictor.reset(initial_power=3500.0)                     # mW
    power_mw = predictor.step(v_cmd, w_cmd)                   # m/s, rad/s
    power_mw = predictor.step_with_correction(v_cmd, w_cmd, measured_power_mw)

`step` continues with its own forecasts: for simulation. `step_with_correction` continues with the
measured power: on a robot. Arrays, one element for each robot, are taken instead of numbers.
"""
import math

import numpy as np

# Time between two readings of the training data, s. None if the model does not state it.
PERIOD_S = @PERIOD_S@
ACTIVATION = "@ACTIVATION@"
LAGS = 5
# Number of features read: 11, or the 5 powers alone.
INPUTS = @INPUTS@
# Shapes of the arrays, one after the other.
SHAPES = @SHAPES@

_erf = np.frompyfunc(math.erf, 1, 1)


def _activated(values):
    if ACTIVATION == "relu":
        return np.maximum(values, 0.0)
    if ACTIVATION == "gelu_tanh":
        inner = math.sqrt(2.0 / math.pi) * (values + 0.044715 * values**3)
        return 0.5 * values * (1.0 + np.tanh(inner))
    return 0.5 * values * (1.0 + _erf(values * math.sqrt(0.5)).astype(np.float64))


def _arrays(data):
    numbers, arrays, at = np.frombuffer(data, "<f4").astype(np.float64), {}, 0
    for name, shape in SHAPES.items():
        size = math.prod(shape)
        arrays[name] = numbers[at:at + size].reshape(shape)
        at += size
    return arrays


class EnergyPredictor:
    """The network with its normalisation and the last five powers of one robot, or of several."""

    def __init__(self, path=None, period_s=PERIOD_S):
        """`path`: an .npz file of another model of the same shape, by `joulebus model export`.
        The one inside by default. `period_s`: time between two steps, s, by default that of the training data."""
        if period_s is None:
            raise ValueError("the model does not state its period: give period_s, the time between two steps in s (0.033 in the Robotarium)")
        if not 0.0 < period_s < math.inf:
            raise ValueError(f"period_s is {period_s}, allowed is a finite time above 0 s")
        self.period_s = period_s
        if path is None:
            self._model = _arrays(bytes.fromhex(_MODEL))
        else:
            with np.load(path, allow_pickle=False) as found:
                self._model = {name: found[name].astype(np.float64) for name in SHAPES}
        for name, shape in SHAPES.items():
            if self._model[name].shape != shape:
                raise ValueError(f"{path}: {name} has shape {self._model[name].shape}, allowed is {shape}")
        self.reset()

    def reset(self, initial_power=3500.0):
        """Begins anew, at rest with `initial_power` (mW) as all readings before."""
        power_w = 1e-3 * np.asarray(initial_power, np.float64)
        if not np.all(np.isfinite(power_w)):
            raise ValueError(f"initial_power is {initial_power}, allowed are finite powers in mW")
        self._lag_w = [power_w] * LAGS
        self._before = None

    def step(self, v_cmd, w_cmd):
        """The power of the next step in mW, under a command in m/s and rad/s."""
        forecast_w = self._forecast_w(v_cmd, w_cmd)
        self._push(forecast_w, forecast_w)
        return self._milliwatt(forecast_w)

    def step_with_correction(self, v_cmd, w_cmd, measured_power):
        """As `step`. The next one continues with `measured_power` (mW), and with the forecast where
        it is NaN."""
        measured_w = 1e-3 * np.asarray(measured_power, np.float64)
        forecast_w = self._forecast_w(v_cmd, w_cmd)
        self._push(forecast_w, measured_w)
        return self._milliwatt(forecast_w)

    def predict(self, features):
        """Forecasts in W of rows of features in SI units (n, 11): v, omega, their derivatives, their
        magnitudes, and the last five powers, newest first."""
        model = self._model
        values = np.asarray(features, np.float64)[..., -INPUTS:]
        values = (values - model["feature_mean"]) / model["feature_std"]
        for number in range(4):
            values = values @ model[f"layers.{number}.weight"].T + model[f"layers.{number}.bias"]
            values = _activated(values) if number < 3 else values
        return values[..., 0] * model["power_std_w"] + model["power_mean_w"]

    def _forecast_w(self, v_cmd, w_cmd):
        v, omega = np.asarray(v_cmd, np.float64), np.asarray(w_cmd, np.float64)
        if not (np.all(np.isfinite(v)) and np.all(np.isfinite(omega))):
            raise ValueError(f"the command is {v_cmd} m/s, {w_cmd} rad/s: allowed are finite numbers")
        v_before, omega_before = self._before or (v, omega)
        changes = ((v - v_before) / self.period_s, (omega - omega_before) / self.period_s)
        columns = [v, omega, *changes, np.abs(v), np.abs(omega), *self._lag_w]
        self._before = (v, omega)
        return self.predict(np.stack(np.broadcast_arrays(*columns), axis=-1))

    def _push(self, forecast_w, newest_w):
        # Of its own forecasts only what the training data had is fed back.
        newest = INPUTS - LAGS
        low_w, high_w = (self._model[name][newest] for name in ("feature_min", "feature_max"))
        fed_back_w = np.clip(forecast_w, low_w, high_w)
        is_own = np.isnan(newest_w) | (newest_w is forecast_w)
        self._lag_w = [np.where(is_own, fed_back_w, newest_w), *self._lag_w[:-1]]

    @staticmethod
    def _milliwatt(power_w):
        power_mw = 1e3 * power_w
        return float(power_mw) if np.ndim(power_mw) == 0 else power_mw


_MODEL = """
@MODEL@
"""
