"""Forecasts of the power and energy of robot fleets: on NumPy arrays, and live in shared memory.

    import joulebus

    predictor = joulebus.EnergyPredictor()                   # the paper's interface, one robot, mW
    power_mw = predictor.step(0.1, 0.0)

    model = joulebus.Predictor()                             # any number of robots at once, SI units
    energy_j, power_w = model.rollout(v, omega)              # v[robot, step] in m/s, omega in rad/s

    with joulebus.Planner("configs/fleet.toml") as planner:  # a fleet live
        for event in planner.events(timeout=5.0):
            ...
        answers = planner.what_if(7, v, omega)               # what candidates of commands would cost
        trip = planner.ask(7, path, back_to=(0.0, 0.0))[0]   # does it make it there and back?

    forecasts = joulebus.read("run.mcap", "forecasts")       # a capture, as a DataFrame

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
    RecordingError,
    __version__,
)
from .live import BUDGET, DIAGNOSTIC, FORECAST, Forecast, Frame, Gone, Planner, Publisher, Stale, Table
from .predictor import Predictor
from .questions import Answer, Answers
from .recordings import SAMPLE, RecordingDamaged, Trial, read, read_arrays, read_trials

__all__ = [
    "Answer",
    "Answers",
    "BUDGET",
    "DIAGNOSTIC",
    "FEATURE_NAMES",
    "FORECAST",
    "SAMPLE",
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
    "RecordingDamaged",
    "RecordingError",
    "Stale",
    "Table",
    "Trial",
    "__version__",
    "read",
    "read_arrays",
    "read_trials",
]


def __getattr__(name: str) -> object:
    # Needs the Robotarium's simulator, which is imported only where it is used.
    if name == "EnergyRobotarium":
        from .robotarium import EnergyRobotarium

        return EnergyRobotarium
    raise AttributeError(f"module 'joulebus' has no attribute {name!r}")
