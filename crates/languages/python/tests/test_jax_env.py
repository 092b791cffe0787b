"""The environment in JAX: the numbers of the one in NumPy, compiled and vectorised."""
from __future__ import annotations

import joulebus
import numpy as np
import pytest

jax = pytest.importorskip("jax")
jnp = jax.numpy

ROBOTS = 3
#: It charges a robot at a time, two batteries run empty, goals are reached.
ARGUMENTS = {
    "battery_j": [9.0, 20.0, 300.0],
    "initial_soc": [1.0, 0.9, 0.5],
    "chargers": [[0.3, -0.4], [0.2, 0.1]],
    "charger_radius": 0.6,
    "charge_power_w": 30.0,
    "goal_radius": 0.5,
    "max_steps": 400,
}


def as_state(envs, fresh):
    """The state of the only arena of an environment in NumPy, before its first step."""
    return fresh._replace(poses=jnp.asarray(envs._poses[:, 0], jnp.float32), goals=jnp.asarray(envs._goals[:, 0], jnp.float32))


@pytest.mark.parametrize("model", ["builtin:gternal-sim", "builtin:gternal-sim-power"])
def test_steps_are_those_in_numpy_within_single_precision(model):
    env = joulebus.EnergyJaxEnv(ROBOTS, model=model, **ARGUMENTS)
    envs = joulebus.EnergyVectorEnv(1, robots=ROBOTS, model=model, **ARGUMENTS)
    key = jax.random.key(1)
    envs.reset(seed=6)
    # Compiled as a whole: JAX takes seconds to compile operations one by one.
    state, step, noise = as_state(envs, jax.jit(env.reset)(key)[1]), jax.jit(env.step_env), np.random.default_rng(2)
    charged, emptied, reached = False, False, 0
    for _ in range(300):
        # Beyond what the wheels can do, too.
        actions = noise.uniform([-0.05, -4.0], [0.25, 4.0], (ROBOTS, 2)).astype(np.float32)
        expected, rewards, terminated, truncated, infos = envs.step(actions[None])
        _, state, each, dones, told = step(key, state, {f"robot_{robot}": actions[robot] for robot in range(ROBOTS)})
        assert np.array_equal(np.asarray(told["goals"]), infos["goals"][0])
        # A goal that was reached is drawn anew, by other random numbers.
        state = state._replace(goals=jnp.asarray(envs._goals[:, 0], jnp.float32))
        found = env.get_obs(state)
        found = np.stack([np.asarray(found[agent]) for agent in env.agents])
        # Measured with four seeds: 2e-6 (m, W) and 1.3e-5 to 1.1e-4 J.
        assert np.abs(found - expected[0]).max() <= 2e-5
        assert np.abs(np.asarray(told["energy_j"]) - infos["energy_j"][0]).max() <= 1e-3
        assert np.array_equal(np.asarray(told["charging"]), infos["charging"][0])
        assert sum(float(one) for one in each.values()) == pytest.approx(rewards[0], abs=5e-4)
        assert bool(dones["__all__"]) == bool(terminated[0] or truncated[0])
        charged, emptied = charged or infos["charging"].any(), emptied or (infos["soc"] == 0.0).any()
        reached = infos["goals"].sum()
    assert charged and emptied and reached


def test_hundreds_of_arenas_are_compiled_together():
    env, arenas = joulebus.EnergyJaxEnv(2, max_steps=20, battery_j=5.0), 256
    drive = {agent: jnp.array([0.1, 0.3]) for agent in env.agents}

    @jax.jit
    def run(key):
        begins, steps = jax.random.split(key)
        _, begun = jax.vmap(env.reset)(jax.random.split(begins, arenas))

        def one(state, keys):
            observations, state, rewards, dones, _ = jax.vmap(env.step, in_axes=(0, 0, None))(keys, state, drive)
            return state, (observations["robot_0"], rewards["robot_0"], dones["__all__"], keys)

        return begun, jax.lax.scan(one, begun, jax.random.split(steps, (30, arenas)))

    first, (state, (observations, rewards, dones, keys)) = run(jax.random.key(4))
    assert observations.shape == (30, arenas, 8) and np.isfinite(np.asarray(rewards)).all()
    # Every episode ends by its twentieth step, and begins anew.
    assert np.asarray(dones).any(axis=0).all() and (np.asarray(state.steps) < 20).all()
    assert (np.asarray(state.left_j) > 0.0).all()
    # Each arena depends on its own keys alone.
    begun = jax.tree.map(lambda values: values[5], first)
    alone, *_ = jax.jit(env.step)(keys[0, 5], begun, drive)
    assert np.asarray(alone["robot_0"]) in env.observation_space("robot_0") and drive["robot_1"].shape == env.action_space("robot_1").shape
    assert np.allclose(alone["robot_0"], observations[0, 5], atol=1e-5)


def test_a_step_can_be_differentiated():
    env = joulebus.EnergyJaxEnv(1)
    _, state = jax.jit(env.reset)(jax.random.key(5))

    @jax.jit
    def cost_j(action):
        at = state
        for _ in range(2):
            _, at, *_ = env.step_env(jax.random.key(0), at, {"robot_0": action})
        return at.drawn_j.sum()

    action, small = jnp.array([0.1, 0.5]), np.float32([1e-2, 0.0])
    slope = jax.jit(jax.grad(cost_j))(action)
    difference = (cost_j(action + small) - cost_j(action - small)) / 2e-2
    assert float(slope[0]) == pytest.approx(float(difference), rel=0.1, abs=0.02) and np.isfinite(np.asarray(slope)).all()


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="robots is 0, allowed are 1 or more"):
        joulebus.EnergyJaxEnv(0)
