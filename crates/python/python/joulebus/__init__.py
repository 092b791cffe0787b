"""Forecasts of the power and energy of robot fleets: on NumPy arrays, and live in shared memory.

    import joulebus

    predictor = joulebus.EnergyPredictor()                   # the paper's interface, one robot, mW
    power_mw = predictor.step(0.1, 0.0)

    model = joulebus.Predictor()                             # any number of robots at once, SI units
    energy_j, power_w = model.rollout(v, omega)              # v[robot, step] in m/s, omega in rad/s

    with joulebus.Planner("configs/fleet.toml") as planner:  # a fleet live
        for event in planner.events(timeout=5.0):
            ...

Numbers are the bits that joulebus itself computes. Everything that is refused is an exception whose message
says what was found, what is allowed and what to do.
"""
from ._native import (
    FEATURE_NAMES,
    ConnectError,
    EnergyPredictor,
    Error,
    ModelError,
    PublishError,
    ReadError,
    __version__,
)
from .live import BUDGET, DIAGNOSTIC, FORECAST, Forecast, Frame, Gone, Planner, Publisher, Stale, Table
from .predictor import Predictor

__all__ = [
    "BUDGET",
    "DIAGNOSTIC",
    "FEATURE_NAMES",
    "FORECAST",
    "ConnectError",
    "EnergyPredictor",
    "Error",
    "Forecast",
    "Frame",
    "Gone",
    "ModelError",
    "Planner",
    "Predictor",
    "PublishError",
    "Publisher",
    "ReadError",
    "Stale",
    "Table",
    "__version__",
]
