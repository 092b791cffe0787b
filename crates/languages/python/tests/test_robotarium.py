"""The Robotarium's simulator with batteries, beside the real rps in ../shared."""
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import joulebus
import numpy as np
import pytest
from conftest import ROOT, needed
from worker import PATIENCE_S

RPS = ROOT.parent / "shared/rps"


@pytest.fixture(scope="module")
def rps():
    if not (RPS / "rps/robotarium.py").is_file():
        needed(f"rps in {RPS}")
    os.environ.setdefault("MPLBACKEND", "Agg")
    sys.path.append(str(RPS))
    import rps.robotarium

    yield rps.robotarium
    sys.path.remove(str(RPS))


def started(kind, robots: int = 3, **more):
    np.random.seed(5)
    poses = np.vstack([np.linspace(-1.0, 1.0, robots), np.zeros(robots), np.full(robots, 0.3)])
    return kind(
        number_of_robots=robots,
        sim_in_real_time=False,
        skip_initialization=True,
        initial_conditions=poses,
        **more,
    )


def driven(robotarium, steps: int, v: float = 0.08):
    """Poses of each step, and what was drawn."""
    found, robots = [], robotarium.number_of_robots
    for step in range(steps):
        found.append(robotarium.get_poses())
        velocities = np.vstack([np.full(robots, v), np.full(robots, 2.0 * np.sin(0.1 * step))])
        robotarium.set_velocities(np.arange(robots), velocities)
        robotarium.step()
    return np.array(found)


def test_robots_move_as_in_the_simulator_and_draw_what_the_model_forecasts(rps):
    energy = started(joulebus.EnergyRobotarium)
    assert isinstance(energy, rps.Robotarium)
    assert np.array_equal(driven(energy, 50), driven(started(rps.Robotarium), 50))
    model = joulebus.EnergyPredictor()
    model.reset(np.full(3, 3500.0))
    robotarium, drawn_j = started(joulebus.EnergyRobotarium, battery_j=[100.0, 200.0, 300.0]), np.zeros(3)
    for _ in range(20):
        driven(robotarium, 1, v=0.1)
        power_w = 1e-3 * model.step(robotarium._velocities[0], robotarium._velocities[1])
        assert robotarium.get_power().tobytes() == power_w.tobytes()
        drawn_j += 0.033 * power_w
    assert np.allclose(robotarium.get_energy(), drawn_j, rtol=1e-12)
    assert np.allclose(robotarium.get_soc(), 1.0 - drawn_j / [100.0, 200.0, 300.0], rtol=1e-12)
    assert robotarium.get_charging().tolist() == [False] * 3
    # What is returned is the caller's.
    robotarium.get_energy()[:] = -1.0
    assert (robotarium.get_energy() > 0.0).all()


def test_a_robot_with_an_empty_battery_stops_draws_nothing_and_no_more_than_it_had(rps):
    robotarium = started(joulebus.EnergyRobotarium, battery_j=[1.0, 1000.0, 1.0], initial_soc=[1.0, 1.0, 0.0])
    poses = driven(robotarium, 60)
    assert robotarium.get_soc().tolist()[::2] == [0.0, 0.0] and robotarium.get_power().tolist()[::2] == [0.0, 0.0]
    assert robotarium.get_energy()[0] == pytest.approx(1.0, abs=1e-12) and robotarium.get_energy()[2] == 0.0
    moved_m = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    assert (moved_m[:, 2] == 0.0).all() and (moved_m[-5:, 0] == 0.0).all()
    assert moved_m[0, 0] > 0.0 and (moved_m[:, 1] > 0.0).all()


def test_a_charger_fills_the_nearest_robot_which_then_moves_again(rps):
    robotarium = started(
        joulebus.EnergyRobotarium,
        battery_j=10.0,
        initial_soc=[0.0, 0.5, 0.5],
        chargers=[[-1.0, -1.0, 5.0], [0.05, 0.05, 0.0]],
        charge_power_w=30.0,
        charger_radius=0.1,
    )
    driven(robotarium, 1, v=0.0)
    assert robotarium.get_charging().tolist() == [True, False, False]
    # One charger's worth, although there are two.
    assert robotarium.get_soc()[0] == pytest.approx(30.0 * 0.033 / 10.0)
    driven(robotarium, 20, v=0.0)
    assert robotarium.get_soc()[0] > 0.3 and robotarium.get_power()[0] > 0.0
    driven(robotarium, 400, v=0.0)
    assert 0.9 < robotarium.get_soc()[0] <= 1.0
    before = robotarium.get_poses()
    robotarium._checked_poses_already = False
    assert np.linalg.norm(driven(robotarium, 30)[-1][:2, 0] - before[:2, 0]) > 0.01


def test_wrong_arguments_are_refused_with_what_is_allowed(rps):
    for said, more in [
        ("battery_j is 0.0, allowed are finite numbers above 0", dict(battery_j=0.0)),
        ("battery_j is nan", dict(battery_j=float("nan"))),
        ("battery_j has shape (2,), allowed: () or (3,)", dict(battery_j=[1.0, 2.0])),
        ("initial_soc is 1.5, allowed are 0 to 1", dict(initial_soc=1.5)),
        ("chargers has shape (3,), allowed: (2, chargers)", dict(chargers=[1.0, 2.0, 3.0])),
        ("charge_power_w is -1.0", dict(charge_power_w=-1.0)),
    ]:
        with pytest.raises(ValueError) as refused:
            started(joulebus.EnergyRobotarium, **more)
        assert said in str(refused.value)
    with pytest.raises(joulebus.ModelError, match="no built-in model"):
        started(joulebus.EnergyRobotarium, model="builtin:none")
    for kind in (rps.Robotarium, joulebus.EnergyRobotarium):
        with pytest.raises(AssertionError):
            kind(number_of_robots="three")
    with pytest.raises(ValueError, match="a velocity is not finite"):
        driven(started(joulebus.EnergyRobotarium), 1, v=float("nan"))


EXAMPLES = """
import os, runpy, sys
import numpy as np
import matplotlib.pyplot as plt
import rps.robotarium
from joulebus import EnergyRobotarium

class Ended(BaseException):
    pass

class Hurried(EnergyRobotarium):
    # What an example needs minutes for: real time, driving to the beginning, and its many steps.
    def __init__(self, **arguments):
        super().__init__(**(arguments | dict(sim_in_real_time=False, skip_initialization=True)))
        self.steps, self.all = 0, made.append(self)

    def step(self):
        super().step()
        self.steps += 1
        if self.steps >= 25:
            raise Ended

rps.robotarium.Robotarium = Hurried
plt.pause = lambda *_: None
plt.show = lambda *_, **__: None
for path in sys.argv[1:]:
    made, sys.argv = [], [path]
    np.random.seed(3)
    sys.path[0] = os.path.dirname(path)
    try:
        runpy.run_path(path, run_name="__main__")
    except Ended:
        pass
    plt.close("all")
    [robotarium] = made
    assert robotarium.get_energy().shape == (robotarium.number_of_robots,), path
    assert (robotarium.get_energy() > 0.0).all() and (robotarium.get_soc() < 1.0).all(), path
    print(os.path.basename(path), robotarium.steps, flush=True)
"""


def scripts() -> list[Path]:
    found = sorted((RPS / "rps/examples").rglob("*.py"))
    return [path for path in found if "Robotarium(" in path.read_text()]


def python(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(RPS)]), "MPLBACKEND": "Agg"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, timeout=5 * PATIENCE_S
    )


def test_every_example_of_the_simulator_runs_unchanged(rps, tmp_path):
    paths = scripts()
    assert len(paths) >= 15
    done = python(["-c", EXAMPLES, *map(str, paths)], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines() if line.split()[-1:] == ["25"]] == [
        path.name for path in paths
    ], done.stdout


def test_a_script_runs_with_batteries_by_the_module(rps, tmp_path):
    script = tmp_path / "mine.py"
    script.write_text(
        "import sys\nimport numpy as np\nfrom rps.robotarium import Robotarium\n"
        "r = Robotarium(number_of_robots=2, sim_in_real_time=False, skip_initialization=True)\n"
        "for _ in range(10):\n    r.get_poses()\n    r.step()\nr.debug()\nprint(sys.argv[1:])\n"
    )
    done = python(["-m", "joulebus.robotarium", str(script), "--mine"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "The robots drew" in done.stdout and "['--mine']" in done.stdout and "energy: " in done.stderr
    assert python(["-m", "joulebus.robotarium"], tmp_path).returncode == 1


def test_without_the_simulator_the_remedy_is_named(tmp_path):
    folders = [folder for folder in sys.path if folder != str(RPS)]
    if any((Path(folder) / "rps").is_dir() for folder in folders):
        pytest.skip("skipped: rps is installed")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(folders)}
    done = subprocess.run(
        [sys.executable, "-c", "import joulebus; joulebus.EnergyRobotarium"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 1 and "rps 2.1" in done.stderr and "robotarium_python_simulator" in done.stderr
