"""The vectorised environment: gymnasium's interface, the model's energies, and the same run from the same seed."""
from __future__ import annotations

import os
import subprocess
import sys
import warnings

import gymnasium
import joulebus
import numpy as np
import pytest
from conftest import ROOT, needed
from gymnasium.vector import AutoresetMode

RPS = ROOT.parent / "shared/rps"


def played(envs, steps: int, seed: int = 1):
    """Observations, rewards and the energies of random actions. Ends in step order."""
    noise, found = np.random.default_rng(seed), []
    for _ in range(steps):
        low, high = envs.single_action_space.low, envs.single_action_space.high
        actions = noise.uniform(low, high, (envs.num_envs, *low.shape)).astype(np.float32)
        found.append(envs.step(actions))
    return found


def test_it_has_the_interface_of_gymnasium():
    envs = joulebus.EnergyVectorEnv(3, robots=2, battery_j=2.0, max_steps=50)
    assert isinstance(envs, gymnasium.vector.VectorEnv) and envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, infos = envs.reset(seed=4)
    assert observations.shape == (3, 2, 8) and observations in envs.observation_space
    assert envs.single_observation_space.shape == (2, 8) and envs.single_action_space.shape == (2, 2)
    for observations, rewards, terminated, truncated, infos in played(envs, 120):
        assert observations in envs.observation_space and observations.dtype == np.float32
        assert rewards.shape == terminated.shape == truncated.shape == (3,)
        assert rewards.dtype == np.float64 and terminated.dtype == truncated.dtype == np.bool_
        assert all(infos[name].shape == (3, 2) and infos[f"_{name}"].all() for name in ("energy_j", "soc", "goals"))
    # Wrappers of gymnasium work on it.
    recorded = gymnasium.wrappers.vector.RecordEpisodeStatistics(joulebus.EnergyVectorEnv(2, max_steps=5))
    recorded.reset(seed=1)
    lengths = [info["episode"]["l"] for *_, info in played(recorded, 6) if "episode" in info]
    assert len(lengths) >= 1 and (lengths[0] == 5).all()
    envs.close()


@pytest.mark.parametrize("robots", [None, 2])
def test_the_checker_of_gymnasium_finds_nothing(robots):
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make("joulebus/Energy-v0", robots=robots, battery_j=20.0, max_steps=100)
    assert isinstance(env.unwrapped, joulebus.EnergyEnv)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Actions are in m/s and rad/s. It recommends -1 to 1.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space.*")
        check_env(env.unwrapped, skip_render_check=True)


def test_one_robot_and_many_of_them_are_made_by_name():
    env = gymnasium.make("joulebus/Energy-v0", battery_j=1.0)
    observation, infos = env.reset(seed=3)
    assert observation.shape == (8,) and env.action_space.shape == (2,) and infos["soc"] == 1.0
    assert np.array_equal(env.reset(seed=3)[0], observation) and not np.array_equal(env.reset()[0], observation)
    ended = next(step for step in range(100) if any(env.step(np.float32([0.1, 0.0]))[2:4]))
    assert 5 < ended < 20
    envs = gymnasium.make_vec("joulebus/Energy-v0", num_envs=3)
    assert isinstance(envs, joulebus.EnergyVectorEnv)
    observations, _ = envs.reset(seed=2)
    assert observations.shape == (3, 8) and envs.step(envs.action_space.sample())[1].shape == (3,)
    assert gymnasium.make_vec("joulebus/Energy-v0", num_envs=3, robots=2).reset()[0].shape == (3, 2, 8)
    # Also where each is a process of its own.
    pooled = gymnasium.make_vec("joulebus/Energy-v0", num_envs=2, vectorization_mode="sync")
    assert pooled.reset(seed=2)[0].shape == (2, 8)
    with pytest.raises(ValueError, match="allowed is None"):
        joulebus.EnergyEnv(render_mode="human")


@pytest.mark.parametrize("order", ["gymnasium, joulebus", "joulebus, gymnasium"])
def test_the_name_is_known_in_either_order_of_imports(order):
    code = f"import {order}; print(gymnasium.make('joulebus/Energy-v0').observation_space.shape)"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "(8,)\n"


def test_without_gymnasium_the_package_is_imported_and_says_what_is_missing():
    code = "import sys; sys.modules['gymnasium'] = None; import joulebus; print(joulebus.Predictor().reads, flush=True); joulebus.EnergyEnv"
    told = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert told.stdout == "full\n" and "pip install gymnasium" in told.stderr


def test_what_needs_other_packages_is_listed():
    names = {"EnergyEnv", "EnergyJaxEnv", "EnergyParallelEnv", "EnergyRobotarium", "EnergyVectorEnv", "OnlineForecaster"}
    assert names <= set(dir(joulebus))


def test_pettingzoo_s_test_finds_nothing():
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(joulebus.EnergyParallelEnv(3, battery_j=5.0, max_steps=60), num_cycles=200)
        parallel_seed_test(lambda: joulebus.EnergyParallelEnv(2, battery_j=5.0, max_steps=60))


def test_agents_are_the_robots_of_an_arena():
    arguments = {"battery_j": 5.0, "chargers": [[0.0], [0.0]], "charger_radius": 0.5}
    envs, env = joulebus.EnergyVectorEnv(1, robots=2, **arguments), joulebus.EnergyParallelEnv(2, **arguments)
    first, _ = envs.reset(seed=4)
    observations, infos = env.reset(seed=4)
    assert env.agents == ["robot_0", "robot_1"] and np.array_equal(np.stack(list(observations.values())), first[0])
    for _ in range(30):
        found, rewards, _, _, more = envs.step(np.float32([[[0.1, 0.5], [0.0, 0.0]]]))
        observations, each, terminated, truncated, infos = env.step({"robot_0": np.float32([0.1, 0.5])})
        assert np.array_equal(np.stack(list(observations.values())), found[0])
        assert sum(each.values()) == pytest.approx(rewards[0]) and infos["robot_1"]["energy_j"] == more["energy_j"][0, 1]
    with pytest.raises(ValueError, match="no agent 'robot_2', allowed are robot_0, robot_1"):
        env.step({"robot_2": [0.0, 0.0]})


def test_the_same_seed_gives_the_same_run_alone_and_among_others():
    def run(count: int, seed: int):
        envs = joulebus.EnergyVectorEnv(count, robots=2, battery_j=5.0, chargers=[[0.0], [0.0]], max_steps=60)
        first, _ = envs.reset(seed=seed)
        steps = []
        for step in range(100):
            v, omega = 0.2 * np.sin(0.1 * step), 2.0 * np.cos(0.05 * step)
            steps.append(envs.step(np.full((count, 2, 2), [v, omega], np.float32)))
        return first, steps

    (first, steps), (again, more) = run(3, 7), run(3, 7)
    assert first.tobytes() == again.tobytes()
    assert all(one[at].tobytes() == other[at].tobytes() for one, other in zip(steps, more) for at in range(4))
    alone, single = run(1, 9)
    assert alone[0].tobytes() == first[2].tobytes()
    for one, other in zip(steps, single):
        assert all(one[at][2].tobytes() == other[at][0].tobytes() for at in range(4))
        assert one[4]["energy_j"][2].tobytes() == other[4]["energy_j"][0].tobytes()
    assert run(1, 8)[0].tobytes() != alone.tobytes()


def test_energies_are_the_models_and_rewards_contain_them():
    envs = joulebus.EnergyVectorEnv(2, robots=3, battery_j=500.0, energy_weight=0.1, goal_reward=0.0, progress_weight=0.0)
    envs.reset(seed=2)
    model, drawn_j = joulebus.EnergyPredictor(), np.zeros((2, 3))
    model.reset(np.full(6, 3500.0))
    noise = np.random.default_rng(3)
    for _ in range(50):
        # What the wheels can do.
        v, omega = noise.uniform(-0.1, 0.1, (2, 3)), noise.uniform(-1.5, 1.5, (2, 3))
        _, rewards, _, _, infos = envs.step(np.stack([v, omega], axis=-1))
        power_w = 1e-3 * np.asarray(model.step(v.reshape(-1), omega.reshape(-1))).reshape(2, 3)
        assert np.allclose(infos["power_w"], power_w, rtol=1e-5)
        drawn_j += 0.033 * infos["power_w"]
        assert np.allclose(infos["energy_j"], drawn_j, rtol=1e-12)
        assert np.allclose(rewards, -0.1 * infos["step_energy_j"].sum(axis=1), rtol=1e-9)
        assert np.allclose(infos["soc"], 1.0 - drawn_j / 500.0, rtol=1e-12)


def test_empty_robots_stop_and_an_arena_of_them_is_reset_by_the_next_step():
    envs = joulebus.EnergyVectorEnv(2, robots=2, battery_j=[0.5, 1.0], max_steps=500)
    observations, _ = envs.reset(seed=5)
    drive = np.full((2, 2, 2), [0.1, 0.0], np.float32)
    ended = []
    for step in range(30):
        before = observations
        observations, rewards, terminated, truncated, infos = envs.step(drive)
        if terminated.any():
            ended.append(step)
            assert (infos["soc"][terminated] == 0.0).all() and not truncated.any()
            assert np.allclose(infos["energy_j"][terminated], [0.5, 1.0])
            break
        empty = infos["soc"][:, 0] == 0.0
        if step > 0 and (before[:, 0, 6] == 0.0).any():
            still = before[:, 0, 6] == 0.0
            assert (before[still, 0, :4] == observations[still, 0, :4]).all() and empty[still].all()
    assert ended and terminated.all()
    observations, rewards, terminated, truncated, infos = envs.step(drive)
    assert (rewards == 0.0).all() and not terminated.any() and (infos["soc"] == 1.0).all()
    assert (infos["energy_j"] == 0.0).all()
    _, _, _, _, infos = envs.step(drive)
    assert (infos["energy_j"] > 0.0).all()


def test_a_charger_keeps_its_arena_alive_and_charges_no_other():
    envs = joulebus.EnergyVectorEnv(2, battery_j=1.0, chargers=[[0.0], [0.0]], charger_radius=0.5, charge_power_w=30.0)
    envs.reset(seed=1)
    envs._poses[:2, 0, 0], envs._poses[:2, 1, 0] = (0.1, 0.1), (1.0, 0.9)
    rest = np.zeros((2, 1, 2))
    for _ in range(30):
        _, _, terminated, _, infos = envs.step(rest)
        assert infos["charging"].tolist() == [[True], [False]]
        if terminated[1]:
            break
    assert terminated.tolist() == [False, True] and infos["soc"][0, 0] == 1.0


def test_goals_are_rewarded_and_replaced():
    envs = joulebus.EnergyVectorEnv(1, goal_reward=5.0, energy_weight=0.0)
    observations, _ = envs.reset(seed=3)
    envs._poses[:2, 0, 0] = observations[0, 0, 4:6] - [0.1002, 0.0]
    envs._poses[2, 0, 0] = 0.0
    observations, rewards, _, _, infos = envs.step([[[0.1, 0.0]]])
    assert infos["goals"].tolist() == [[1]] and rewards[0] == pytest.approx(5.0 + 0.0033, abs=1e-6)
    assert np.hypot(*(observations[0, 0, :2] - observations[0, 0, 4:6])) > 0.1


def test_robots_move_and_draw_as_in_the_robotarium():
    if not (RPS / "rps/robotarium.py").is_file():
        needed(f"rps in {RPS}")
    os.environ.setdefault("MPLBACKEND", "Agg")
    sys.path.append(str(RPS))
    try:
        robots, battery_j = 3, [5.0, 10.0, 100.0]
        envs = joulebus.EnergyVectorEnv(1, robots=robots, battery_j=battery_j, chargers=[[0.3], [0.2]], charger_radius=0.6)
        envs.reset(seed=11)
        energy = joulebus.EnergyRobotarium(
            number_of_robots=robots, sim_in_real_time=False, skip_initialization=True, battery_j=battery_j,
            initial_conditions=envs._poses[:, 0].copy(), chargers=[[0.3], [0.2]], charger_radius=0.6,
        )
    finally:
        sys.path.remove(str(RPS))
    for step in range(100):
        # Beyond what the wheels can do, too.
        wanted = np.array([np.full(robots, 0.05), 8.0 * np.sin(0.1 * step + np.arange(robots))])
        energy.get_poses()
        energy.set_velocities(np.arange(robots), wanted)
        energy.step()
        _, _, _, _, infos = envs.step(wanted.T[None])
        assert np.allclose(envs._poses[:, 0], energy._poses, atol=1e-9)
        assert np.allclose(infos["energy_j"][0], energy.get_energy(), rtol=1e-6)
        assert np.allclose(infos["soc"][0], energy.get_soc(), atol=1e-6)
        assert infos["charging"][0].tolist() == energy.get_charging().tolist()


def test_wrong_arguments_are_refused_with_what_is_allowed():
    for said, call in [
        ("num_envs is 0, allowed are 1 or more", lambda: joulebus.EnergyVectorEnv(0)),
        ("battery_j is 0.0, allowed are finite numbers above 0", lambda: joulebus.EnergyVectorEnv(1, battery_j=0.0)),
        ("initial_soc is 2.0, allowed are 0 to 1", lambda: joulebus.EnergyVectorEnv(1, initial_soc=2.0)),
        ("chargers has shape (2,)", lambda: joulebus.EnergyVectorEnv(1, chargers=[0.0, 0.0])),
        ("charger_radius is nan", lambda: joulebus.EnergyVectorEnv(1, charger_radius=float("nan"))),
        ("2 seeds, allowed are 3", lambda: joulebus.EnergyVectorEnv(3).reset(seed=[1, 2])),
    ]:
        with pytest.raises(ValueError) as refused:
            call()
        assert said in str(refused.value)
    envs = joulebus.EnergyVectorEnv(2)
    envs.reset(seed=[1, None])
    for actions in [np.zeros((2, 2)), np.full((2, 1, 2), np.nan)]:
        with pytest.raises(ValueError, match=r"allowed: \(2, 1, 2\), finite"):
            envs.step(actions)
