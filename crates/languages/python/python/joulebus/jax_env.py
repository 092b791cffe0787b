"""The environment as pure functions of JAX, to be compiled, vectorised and differentiated.

    import jax
    from joulebus import EnergyJaxEnv          # needs jax, gymnasium, and the lab

    env = EnergyJaxEnv(robots=2, chargers=[[0.0], [0.0]])
    keys = jax.random.split(jax.random.key(7), 1024)
    observations, state = jax.vmap(env.reset)(keys)                        # {"robot_0": (1024, 8), …}
    step = jax.jit(jax.vmap(env.step))
    observations, state, rewards, dones, infos = step(keys, state, actions)
"""
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from . import network, vector_env
from ._optional import needed

_jax = needed("jax", "environments in JAX")
_numpy = needed("jax.numpy", "environments in JAX")

#: Readings of a robot at rest before its first step, W: those of `EnergyPredictor`.
AT_REST_W = 3.5
LAGS = 5


class EnergyState(NamedTuple):
    """One arena between two steps: arrays of JAX, single precision."""

    poses: Any
    """x, y (m) and heading (rad), ``(3, robots)``."""
    goals: Any
    """``(2, robots)``, m."""
    before: Any
    """v and omega of the last step, ``(2, robots)``."""
    lags_w: Any
    """The last powers, newest first, ``(robots, 5)``."""
    left_j: Any
    """Energy in each battery."""
    drawn_j: Any
    """Energy drawn in the episode."""
    power_w: Any
    """Power of the last step."""
    charging: Any
    """Whether each was charged in the last step."""
    reached: Any
    """Goals reached in the episode."""
    steps: Any
    """Steps of the episode."""


class EnergyJaxEnv:
    """One arena of `EnergyVectorEnv` as functions without side effects, in the shape of JaxMARL and JaxRobotarium.

    Arguments, observations, actions, rewards and the end of an episode are those of
    `EnergyVectorEnv`, for each robot: dicts with ``robot_0``, ``robot_1``, and so on. ``dones`` has
    ``__all__`` too. Motion, powers and energies are those of `EnergyVectorEnv` within single
    precision: 2e-5 m, 2e-5 W and 1e-3 J during 300 steps. Start and goal positions come from JAX's
    random numbers, so they differ.
    """

    def __init__(
        self,
        robots: int = 1,
        *,
        battery_j: Any = 200.0,
        initial_soc: Any = 1.0,
        chargers: Any = None,
        charge_power_w: float = 20.0,
        charger_radius: float = 0.1,
        max_steps: int = 1000,
        goal_radius: float = 0.1,
        goal_reward: float = 1.0,
        progress_weight: float = 1.0,
        energy_weight: float = 0.05,
        model: Any = "builtin:gternal-sim",
    ) -> None:
        # It checks the arguments.
        same = vector_env.EnergyVectorEnv(
            1,
            robots=robots,
            battery_j=battery_j,
            initial_soc=initial_soc,
            chargers=chargers,
            charge_power_w=charge_power_w,
            charger_radius=charger_radius,
            max_steps=max_steps,
            goal_radius=goal_radius,
            model=model,
        )
        self.num_agents, self.max_steps = robots, max_steps
        self.agents = [f"robot_{robot}" for robot in range(robots)]
        self._capacity_j, self._initial_j = _numpy.asarray(same._capacity_j), _numpy.asarray(same._initial_j)
        self._chargers = np.zeros((0, 2)) if chargers is None else np.asarray(chargers, np.float64).T
        self._charge_j, self._charger_radius = charge_power_w * vector_env.STEP_S, charger_radius
        self._goal_radius, self._goal_reward = goal_radius, goal_reward
        self._progress_weight, self._energy_weight = progress_weight, energy_weight
        self._params, self._forward = network.arrays(model, _numpy), network.forward(model, _numpy)
        found, _ = network._contents(model)
        newest = 6 - network._FIRST[len(found["feature_min"])]
        self._fed_back_w = float(found["feature_min"][newest]), float(found["feature_max"][newest])

    def reset(self, key: Any) -> tuple[dict[str, Any], EnergyState]:
        """Begins an episode: observations, and the state."""
        places, headings, goals = _jax.random.split(key, 3)
        shape, angles = (self.num_agents,), (-np.pi, np.pi)
        theta = _jax.random.uniform(headings, shape, minval=angles[0], maxval=angles[1])
        zeros = _numpy.zeros(shape)
        state = EnergyState(
            poses=_numpy.concatenate([self._places(places), theta[None]]),
            goals=self._places(goals),
            before=_numpy.zeros((2, *shape)),
            lags_w=_numpy.full((*shape, LAGS), AT_REST_W, zeros.dtype),
            left_j=self._initial_j,
            drawn_j=zeros,
            power_w=zeros,
            charging=_numpy.zeros(shape, bool),
            reached=_numpy.zeros(shape, int),
            steps=_numpy.zeros((), int),
        )
        return self.get_obs(state), state

    def step(
        self, key: Any, state: EnergyState, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], EnergyState, dict[str, Any], dict[str, Any], dict[str, Any]]:
        """One step of 33 ms. An arena whose episode ends is reset at once, as JaxMARL's are."""
        ahead, again = _jax.random.split(key)
        _, after, rewards, dones, infos = self.step_env(ahead, state, actions)
        _, fresh = self.reset(again)
        state = _jax.tree.map(lambda new, old: _numpy.where(dones["__all__"], new, old), fresh, after)
        return self.get_obs(state), state, rewards, dones, infos

    def step_env(
        self, key: Any, state: EnergyState, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], EnergyState, dict[str, Any], dict[str, Any], dict[str, Any]]:
        """As `step`, without a reset: what follows the end of an episode goes on."""
        wanted = _numpy.stack([_numpy.asarray(actions[agent], _numpy.float32) for agent in self.agents])
        moved = _numpy.stack(vector_env._limited(wanted[:, 0], wanted[:, 1], _numpy))
        v, omega = moved = _numpy.where(state.left_j <= 0.0, 0.0, moved)
        poses = _numpy.stack(vector_env._moved(state.poses, v, omega, _numpy))
        forecast_w = self._forecast_w(state, moved)
        # An empty battery gives nothing, the last step of a battery what is left.
        power_w = _numpy.where(state.left_j > 0.0, forecast_w, 0.0)
        step_j = _numpy.minimum(power_w * vector_env.STEP_S, state.left_j)
        left_j, charging = self._charged(state.left_j - step_j, poses)
        before_m, after_m = (_numpy.hypot(*(found[:2] - state.goals)) for found in (state.poses, poses))
        reached = after_m <= self._goal_radius
        rewards = self._progress_weight * (before_m - after_m) + self._goal_reward * reached - self._energy_weight * step_j
        fed_back_w = _numpy.clip(forecast_w, *self._fed_back_w)
        state = EnergyState(
            poses=poses,
            goals=_numpy.where(reached, self._places(key), state.goals),
            before=moved,
            lags_w=_numpy.concatenate([fed_back_w[:, None], state.lags_w[:, :-1]], axis=1),
            left_j=left_j,
            drawn_j=state.drawn_j + step_j,
            power_w=power_w,
            charging=charging,
            reached=state.reached + reached,
            steps=state.steps + 1,
        )
        done = ((left_j <= 0.0) & ~charging).all() | (state.steps >= self.max_steps)
        infos = {
            "energy_j": state.drawn_j,
            "step_energy_j": step_j,
            "soc": left_j / self._capacity_j,
            "power_w": power_w,
            "charging": charging,
            "goals": state.reached,
        }
        dones = dict.fromkeys([*self.agents, "__all__"], done)
        return self.get_obs(state), state, self._each(rewards), dones, infos

    def observation_space(self, agent: str) -> Any:
        """Of one robot, as a space of gymnasium."""
        return vector_env._spaces(())[0]

    def action_space(self, agent: str) -> Any:
        """Of one robot, as a space of gymnasium: v (m/s) and omega (rad/s)."""
        return vector_env._spaces(())[1]

    def get_obs(self, state: EnergyState) -> dict[str, Any]:
        """The observation of each robot, ``(8,)``."""
        x, y, theta = state.poses
        power_w = _numpy.clip(state.power_w, 0.0, vector_env.POWER_MAX_W)
        soc = state.left_j / self._capacity_j
        columns = [x, y, _numpy.cos(theta), _numpy.sin(theta), *state.goals, soc, power_w]
        return self._each(_numpy.stack(columns, axis=-1))

    def _each(self, values: Any) -> dict[str, Any]:
        return {agent: values[robot] for robot, agent in enumerate(self.agents)}

    def _places(self, key: Any) -> Any:
        x0, x1, y0, y1 = vector_env.ARENA_M
        most = _numpy.array([[x1], [y1]]) - vector_env.MARGIN_M
        least = _numpy.array([[x0], [y0]]) + vector_env.MARGIN_M
        return _jax.random.uniform(key, (2, self.num_agents), minval=least, maxval=most)

    def _forecast_w(self, state: EnergyState, moved: Any) -> Any:
        # At the first step there is no command before.
        change = _numpy.where(state.steps > 0, (moved - state.before) / vector_env.STEP_S, 0.0)
        features = [*moved, *change, *_numpy.abs(moved), *state.lags_w.T]
        return self._forward(self._params, _numpy.stack(features, axis=-1))

    def _charged(self, left_j: Any, poses: Any) -> tuple[Any, Any]:
        charging = _numpy.zeros(left_j.shape, bool)
        for x_m, y_m in self._chargers:
            away_m = _numpy.hypot(poses[0] - x_m, poses[1] - y_m)
            nearest = _numpy.arange(len(self.agents)) == _numpy.argmin(away_m)
            charging |= nearest & (away_m <= self._charger_radius)
        filled_j = _numpy.minimum(left_j + self._charge_j, self._capacity_j)
        return _numpy.where(charging, filled_j, left_j), charging
