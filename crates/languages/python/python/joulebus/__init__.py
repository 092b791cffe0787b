"""Forecasts of the power and energy of robot fleets: on NumPy arrays, and live in shared memory.

    import joulebus

    predictor = joulebus.EnergyPredictor()                   # the paper's interface, one robot, mW
    power_mw = predictor.step(0.1, 0.0)

    model = joulebus.Predictor()                             # any number of robots at once, SI units
    energy_j, power_w = model.rollout(v, omega)              # v[robot, step] in m/s, omega in rad/s

    with joulebus.demo() as demo:                            # a simulated fleet with its worker
        print(demo.planner.ask(7, [(0.0, 0.0), (1.0, 0.0)], back_to=(0.0, 0.0))[0].verdict)

    with joulebus.Planner("configs/fleet.toml") as planner:  # a fleet live
        for event in planner.events(timeout=5.0):
            ...
        answers = planner.what_if(7, v, omega)               # what candidates of commands would cost
        trip = planner.ask(7, path, back_to=(0.0, 0.0))[0]   # does it make it there and back?

    forecasts = joulebus.read("run.mcap", "forecasts", start=60, stop=120)   # a minute of a capture, as a DataFrame
    for frame in joulebus.read_frames("run.mcap", "samples"):                # a long one, frame by frame
        ...

    made = joulebus.train("recordings/", out="my.safetensors")   # and evaluate, analyze, report, simulate
    params, forecast = joulebus.arrays(made.predictor), joulebus.forward(made.predictor)   # for NumPy, JAX, PyTorch

    joulebus.models.convert("theirs.pt", "plain.safetensors", …)   # a network of PyTorch, ONNX or NumPy, to import

    forecaster = joulebus.OnlineForecaster(model)            # learns from each robot's readings. Needs scikit-learn
    env = gymnasium.make("joulebus/Energy-v0")               # for learning: gymnasium, PettingZoo, JAX

Captures, trials, training and what follows from it need the lab: ``pip install 'joulebus[lab]'``.

Numbers are the bits that joulebus itself computes. Everything that is refused is an exception whose message
says what was found, what is allowed and what to do.
"""
import importlib as _importlib
import sys as _sys

try:
    # It has all that the package's own native half has, and the lab.
    from joulebus_lab import _native
except ModuleNotFoundError:
    from . import _native
else:
    _sys.modules["joulebus._native"] = _native

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
from . import models
from .bags import read_bag
from .demonstration import Demo, demo
from .figures import Figure
from .lab import Analysis, Evaluation, Report, Simulation, Training, analyze, evaluate, report, simulate, train
from .live import (
    BUDGET, DIAGNOSTIC, FORECAST, OUTLOOK, OUTLOOK_S, Forecast, Frame, Gone, Planner, Publisher, Refusal, Stale, Table,
)
from .network import arrays, forward
from .predictor import Predictor
from .questions import Answer, Answers
from .recordings import SAMPLE, RecordingDamaged, Trial, read, read_arrays, read_frames, read_trials
from .tables import read_table

__all__ = [
    "Analysis",
    "Answer",
    "Answers",
    "BUDGET",
    "DIAGNOSTIC",
    "FEATURE_NAMES",
    "FORECAST",
    "SAMPLE",
    "ConnectError",
    "Demo",
    "EnergyPredictor",
    "Error",
    "Evaluation",
    "Figure",
    "Forecast",
    "Frame",
    "Gone",
    "ModelError",
    "OUTLOOK",
    "OUTLOOK_S",
    "Planner",
    "Predictor",
    "PublishError",
    "Publisher",
    "Refusal",
    "ReadError",
    "RecordingDamaged",
    "RecordingError",
    "Report",
    "Simulation",
    "Stale",
    "Table",
    "Training",
    "Trial",
    "__version__",
    "analyze",
    "arrays",
    "demo",
    "evaluate",
    "forward",
    "models",
    "read",
    "read_arrays",
    "read_bag",
    "read_frames",
    "read_table",
    "read_trials",
    "report",
    "simulate",
    "train",
]


#: What needs another package, which is imported only where it is used: the Robotarium's simulator,
#: gymnasium, pettingzoo, jax, scikit-learn.
_OPTIONAL = {
    "EnergyEnv": "vector_env",
    "EnergyJaxEnv": "jax_env",
    "EnergyParallelEnv": "parallel_env",
    "EnergyRobotarium": "robotarium",
    "EnergyVectorEnv": "vector_env",
    "OnlineConformal": "online",
    "OnlineForecaster": "online",
}


def __getattr__(name: str) -> object:
    if name in _OPTIONAL:
        return getattr(_importlib.import_module(f".{_OPTIONAL[name]}", __name__), name)
    raise AttributeError(f"module 'joulebus' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_OPTIONAL})


try:
    from .registration import register as _register

    _register()
except ImportError:
    # No gymnasium, or one that cannot be imported: what needs it says so.
    pass
