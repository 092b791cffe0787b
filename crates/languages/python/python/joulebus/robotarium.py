"""The Robotarium's simulator (`rps` 2.1) with batteries.

    from joulebus import EnergyRobotarium

    r = EnergyRobotarium(number_of_robots=5, battery_j=200.0, chargers=[[1.4], [0.8]])

It takes the arguments of ``rps.robotarium.Robotarium`` and has its methods. A script that makes a ``Robotarium``
runs unchanged, with its energies printed at the end, by

    python -m joulebus.robotarium script.py
"""
from __future__ import annotations

import os
import runpy
import sys
from typing import Any

import numpy as np

from ._native import Batteries

try:
    import rps.robotarium as _rps
except ImportError as error:
    raise ImportError(
        f"EnergyRobotarium is made of the Robotarium's simulator rps 2.1, which cannot be imported ({error}): install "
        "github.com/robotarium/robotarium_python_simulator, and numpy, matplotlib and cvxopt for it"
    ) from error
if not hasattr(_rps.Robotarium, "TIME_STEP"):
    raise ImportError(
        f"the Robotarium's simulator in {os.path.dirname(_rps.__file__)} is earlier than rps 2.1.0, whose names "
        "EnergyRobotarium uses: install github.com/robotarium/robotarium_python_simulator as of April 2026 or later"
    )


class EnergyRobotarium(_rps.Robotarium):
    """``rps.robotarium.Robotarium`` whose robots draw energy from batteries.

    Arguments beside those of ``Robotarium``, for all robots or one for each:

    battery_j:       energy of a full battery, J. The default is 36,000 (10 Wh)
    initial_soc:     state of charge at the beginning, 0 to 1
    chargers:        positions ``(2, chargers)``, m. A robot within `charger_radius` of one is charged: the nearest, if
                     there are several
    charge_power_w:  power into the battery of a robot that is charged, W
    charger_radius:  m
    model:           what a robot draws: a joulebus model file

    The power of each step is the model's open-loop forecast for the velocities that the robots really had, as the
    paper's ``EnergyPredictor.step`` gives it. A robot with an empty battery stops and draws nothing, until it has been
    charged. Driving to the initial conditions draws nothing.
    """

    def __init__(
        self,
        *,
        battery_j: Any = 36_000.0,
        initial_soc: Any = 1.0,
        chargers: Any = None,
        charge_power_w: float = 20.0,
        charger_radius: float = 0.1,
        model: str | os.PathLike[str] = "builtin:gternal-sim",
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        robots = self.number_of_robots
        capacity_j = _each("battery_j", battery_j, robots, 0.0, np.inf)
        soc = _each("initial_soc", initial_soc, robots, 0.0, 1.0)
        places = np.zeros((2, 0)) if chargers is None else np.asarray(chargers, np.float64)
        if places.ndim != 2 or len(places) != 2 or not np.isfinite(places).all():
            raise ValueError(f"chargers has shape {places.shape}, allowed: (2, chargers), finite, in m")
        self._batteries = Batteries(
            model,
            self.TIME_STEP,
            capacity_j.tolist(),
            (capacity_j * soc).tolist(),
            places.T.tolist(),
            float(_each("charge_power_w", charge_power_w, (), 0.0, np.inf)),
            float(_each("charger_radius", charger_radius, (), 0.0, np.inf)),
        )
        self._any_empty = bool(self._batteries.empty().any())

    def step(self) -> None:
        """As of ``Robotarium``. Robots with an empty battery stand still."""
        if self.initializing:
            super().step()
            return
        if self._any_empty:
            self._velocities[:, self._batteries.empty()] = 0.0
        super().step()
        self._any_empty = self._batteries.step(self._velocities, self._poses)

    def get_power(self) -> np.ndarray:
        """Power that each robot drew in the last step, W."""
        return self._batteries.power_w()

    def get_energy(self) -> np.ndarray:
        """Energy that each robot has drawn since its initial conditions, J."""
        return self._batteries.drawn_j()

    def get_soc(self) -> np.ndarray:
        """State of charge of each robot's battery, 0 to 1."""
        return self._batteries.soc()

    def get_charging(self) -> np.ndarray:
        """Whether each robot was charged in the last step."""
        return self._batteries.charging()

    def debug(self) -> None:
        """As of ``Robotarium``, and what the robots have drawn."""
        super().debug()
        print(
            f"The robots drew {self.get_energy().sum():.1f} J; the lowest state of charge is "
            f"{self.get_soc().min(initial=1.0):.3f}, {int(self._batteries.empty().sum())} batteries are empty."
        )


def _each(name: str, given: Any, shape: Any, least: float, most: float) -> np.ndarray:
    """One number for each robot."""
    found = np.asarray(given, np.float64)
    positive = found > least if most == np.inf else found >= least
    if not (positive & (found <= most) & np.isfinite(found)).all():
        bounds = f"{least:g} to {most:g}" if most < np.inf else f"finite numbers above {least:g}"
        raise ValueError(f"{name} is {given}, allowed are {bounds}")
    shape = (shape,) if isinstance(shape, int) else shape
    if found.shape not in ((), shape):
        raise ValueError(f"{name} has shape {found.shape}, allowed: () or {shape}")
    return np.broadcast_to(found, shape).copy()


def main() -> None:
    """Runs a script whose ``rps.robotarium.Robotarium`` is an `EnergyRobotarium`, and prints what was drawn."""
    if len(sys.argv) < 2:
        sys.exit("usage: python -m joulebus.robotarium SCRIPT [ARGUMENT…]")
    # As `python SCRIPT` does.
    sys.argv = sys.argv[1:]
    sys.path[0] = os.path.dirname(os.path.abspath(sys.argv[0]))
    # This file is `__main__` here. Scripts and tests find the class under its own name.
    from joulebus.robotarium import EnergyRobotarium as Energy

    made: list[Energy] = []

    class Counted(Energy):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            made.append(self)

    _rps.Robotarium = Counted
    try:
        runpy.run_path(sys.argv[0], run_name="__main__")
    finally:
        for each in made:
            print(
                f"energy: {each.get_energy().sum():.1f} J of {each.number_of_robots} robots in "
                f"{each._iteration * each.TIME_STEP:.1f} s with initialisation",
                file=sys.stderr,
            )


if __name__ == "__main__":
    main()
