"""Environments of gymnasium whose rewards include the energy.

    import gymnasium

    env = gymnasium.make("joulebus/Energy-v0")                       # `EnergyEnv`: one robot
    envs = gymnasium.make_vec("joulebus/Energy-v0", num_envs=64)     # `EnergyVectorEnv`: 64 of them

    from joulebus import EnergyVectorEnv

    envs = EnergyVectorEnv(64, robots=2, chargers=[[0.0], [0.0]], energy_weight=0.05)
    observations, infos = envs.reset(seed=7)
    observations, rewards, terminated, truncated, infos = envs.step(actions)
"""
from __future__ import annotations

from typing import Any, Sequence

import numpy as np

from ._native import Batteries
from ._optional import needed

gymnasium = needed("gymnasium", "environments")
_vector = needed("gymnasium.vector", "environments")

#: The Robotarium's time of a step (s), arena (m) and wheels (m, rad/s).
STEP_S = 0.033
ARENA_M = (-1.6, 1.6, -1.0, 1.0)
WHEEL_RADIUS_M, BASE_LENGTH_M = 0.016, 0.11
V_MAX_MPS = 0.2
WHEEL_MAX_RADPS = V_MAX_MPS / WHEEL_RADIUS_M
OMEGA_MAX_RADPS = 2.0 * V_MAX_MPS / BASE_LENGTH_M
#: Robots and goals start this far inside the arena's walls, m.
MARGIN_M = 0.15
#: The last element of an observation is at most this, W.
POWER_MAX_W = 100.0


class EnergyVectorEnv(_vector.VectorEnv):  # type: ignore[misc, name-defined]
    """`num_envs` arenas, in each of which `robots` robots drive from goal to goal, and draw energy from batteries.

    Motion, power, batteries and chargers are those of `EnergyRobotarium`: a unicycle with the wheels' limits, and the
    model's open-loop forecast for the velocities that the robots really had. A robot with an empty battery stands still
    and draws nothing until it has been charged. Walls stop robots. Robots do not collide.

    robots:          in each arena. None is one robot, without the axis of robots in all arrays
    battery_j, initial_soc: one number, or one for each robot of an arena
    chargers:        positions ``(2, chargers)``, m, the same in every arena
    charge_power_w, charger_radius: W, m
    max_steps:       steps (33 ms) after which an episode is truncated
    goal_radius:     a robot that comes within it has reached its goal and gets another, m
    goal_reward:     for each goal reached
    progress_weight: reward for each metre nearer to the goal
    energy_weight:   reward lost for each joule drawn
    model:           what a robot draws: a joulebus model file

    Actions are ``(num_envs, robots, 2)``: v (m/s) and omega (rad/s). Observations are ``(num_envs, robots, 8)``: x, y (m),
    cosine and sine of the heading, x and y of the goal (m), state of charge (0 to 1), power of the last step (W). An
    episode terminates when all batteries of its arena are empty and none is being charged. The arena is reset by the next
    `step` (``AutoresetMode.NEXT_STEP``). ``infos`` has ``energy_j`` (drawn in the episode), ``step_energy_j``, ``soc``,
    ``power_w``, ``charging`` and ``goals``, each ``(num_envs, robots)``.

    An arena depends on its own seed only: ``reset(seed=7)`` seeds them with 7, 8, and so on.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": _vector.AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        *,
        robots: int | None = 1,
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
        axis = () if robots is None else (robots,)
        robots = 1 if robots is None else robots
        for name, count in [("num_envs", num_envs), ("robots", robots), ("max_steps", max_steps)]:
            if not count >= 1:
                raise ValueError(f"{name} is {count}, allowed are 1 or more")
        lengths = [("charger_radius", charger_radius), ("goal_radius", goal_radius)]
        for name, number in [("charge_power_w", charge_power_w), *lengths]:
            if not 0.0 < number < np.inf:
                raise ValueError(f"{name} is {number}, allowed are finite numbers above 0")
        self.num_envs, self.robots, self.max_steps = num_envs, robots, max_steps
        self._axis = axis
        self._goal_radius, self._goal_reward = goal_radius, goal_reward
        self._progress_weight, self._energy_weight = progress_weight, energy_weight
        self._capacity_j = _each("battery_j", battery_j, robots)
        self._initial_j = self._capacity_j * _each("initial_soc", initial_soc, robots, most=1.0)
        places = np.zeros((2, 0)) if chargers is None else np.asarray(chargers, np.float64)
        if places.ndim != 2 or len(places) != 2 or not np.isfinite(places).all():
            raise ValueError(f"chargers has shape {places.shape}, allowed: (2, chargers), finite, in m")
        self._batteries = Batteries(
            model,
            STEP_S,
            np.tile(self._capacity_j, num_envs).tolist(),
            np.tile(self._initial_j, num_envs).tolist(),
            places.T.tolist(),
            float(charge_power_w),
            float(charger_radius),
            num_envs,
        )
        self.single_observation_space, self.single_action_space = _spaces(axis)
        batched = _vector.utils.batch_space
        self.action_space = batched(self.single_action_space, num_envs)
        self.observation_space = batched(self.single_observation_space, num_envs)
        shape = (num_envs, robots)
        self._poses = np.zeros((3, *shape))
        self._goals = np.zeros((2, *shape))
        self._reached = np.zeros(shape, np.int64)
        self._drawn_j = np.zeros(shape)
        self._steps = np.zeros(num_envs, np.int64)
        self._ended = np.ones(num_envs, np.bool_)
        self._noise = [np.random.default_rng() for _ in range(num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode in every arena. `seed`: of the first arena, or one for each. Without it they go on."""
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        else:
            seeds = [seed + at for at in range(self.num_envs)] if isinstance(seed, (int, np.integer)) else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds, allowed are {self.num_envs}, one for each environment")
        for at, one in enumerate(seeds):
            if one is not None:
                self._noise[at] = np.random.default_rng(one)
            self._begin(at)
        return self._observations(), self._infos(np.zeros_like(self._drawn_j))

    def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One step of 33 ms in every arena. Those whose episode has ended are reset instead."""
        rewards, step_j, terminated, truncated = self._advance(actions)
        return self._observations(), rewards.sum(axis=1), terminated, truncated, self._infos(step_j)

    def _advance(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A step: rewards and energies of each robot, and which arenas have terminated or were truncated."""
        wanted = np.asarray(actions, np.float64)
        allowed = (self.num_envs, *self._axis, 2)
        if wanted.shape != allowed or not np.isfinite(wanted).all():
            raise ValueError(f"actions have shape {wanted.shape}, allowed: {allowed}, finite, in m/s and rad/s")
        wanted = wanted.reshape(self.num_envs, self.robots, 2)
        again = self._ended.copy()
        v, omega = _limited(wanted[..., 0], wanted[..., 1])
        stands = self._batteries.empty().reshape(self._drawn_j.shape) | again[:, None]
        v[stands] = omega[stands] = 0.0
        before_m = self._distance_m()
        self._poses[:] = _moved(self._poses, v, omega, np)
        flat = (-1, self.num_envs * self.robots)
        self._batteries.step(np.stack([v, omega]).reshape(flat), self._poses.reshape(flat))
        drawn_j = self._batteries.drawn_j().reshape(self._drawn_j.shape)
        step_j, self._drawn_j = drawn_j - self._drawn_j, drawn_j
        after_m = self._distance_m()
        reached = after_m <= self._goal_radius
        rewards = self._progress_weight * (before_m - after_m) + self._goal_reward * reached - self._energy_weight * step_j
        self._steps += 1
        self._reached += reached
        for at, robot in np.argwhere(reached & ~again[:, None]):
            self._goals[:, at, robot] = self._place(at)
        dead = self._batteries.empty() & ~self._batteries.charging()
        terminated = dead.reshape(self._drawn_j.shape).all(axis=1)
        truncated = (self._steps >= self.max_steps) & ~terminated
        for at in np.flatnonzero(again):
            self._begin(at)
        terminated[again] = truncated[again] = False
        rewards[again], step_j[again] = 0.0, 0.0
        self._ended = terminated | truncated
        return rewards, step_j, terminated, truncated

    def _begin(self, at: int) -> None:
        for robot in range(self.robots):
            self._poses[:2, at, robot] = self._place(at)
            self._poses[2, at, robot] = self._noise[at].uniform(-np.pi, np.pi)
            self._goals[:, at, robot] = self._place(at)
        members = range(at * self.robots, (at + 1) * self.robots)
        self._batteries.reset(list(members), self._initial_j.tolist())
        self._drawn_j[at], self._reached[at], self._steps[at], self._ended[at] = 0.0, 0, 0, False

    def _place(self, at: int) -> np.ndarray:
        x0, x1, y0, y1 = ARENA_M
        return self._noise[at].uniform([x0 + MARGIN_M, y0 + MARGIN_M], [x1 - MARGIN_M, y1 - MARGIN_M])

    def _distance_m(self) -> np.ndarray:
        return np.hypot(*(self._poses[:2] - self._goals))

    def _observations(self) -> np.ndarray:
        shape = self._drawn_j.shape
        soc, power_w = self._batteries.soc().reshape(shape), self._batteries.power_w().reshape(shape)
        theta = self._poses[2]
        columns = [*self._poses[:2], np.cos(theta), np.sin(theta), *self._goals, soc, np.clip(power_w, 0.0, POWER_MAX_W)]
        return np.stack(columns, axis=-1).astype(np.float32).reshape(self.num_envs, *self._axis, 8)

    def _infos(self, step_j: np.ndarray) -> dict[str, Any]:
        shape = self._drawn_j.shape
        found = {
            "energy_j": self._drawn_j.copy(),
            "step_energy_j": step_j,
            "soc": self._batteries.soc().reshape(shape),
            "power_w": self._batteries.power_w().reshape(shape),
            "charging": self._batteries.charging().reshape(shape),
            "goals": self._reached.copy(),
        }
        found = {name: values.reshape(self.num_envs, *self._axis) for name, values in found.items()}
        # As gymnasium marks them: each is there for every environment.
        return found | {f"_{name}": np.ones(self.num_envs, np.bool_) for name in found}


class EnergyEnv(gymnasium.Env):  # type: ignore[misc, name-defined]
    """One arena of `EnergyVectorEnv`, with its arguments: by default one robot, as ``joulebus/Energy-v0``.

    Actions are ``(2,)``, observations ``(8,)``, and each of ``infos`` one number. With ``robots=3`` actions are ``(3, 2)``,
    observations ``(3, 8)``, and each of ``infos`` has three.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, *, robots: int | None = None, render_mode: None = None, **arguments: Any) -> None:
        if render_mode is not None:
            raise ValueError(f"render_mode is {render_mode!r}, allowed is None: nothing is drawn")
        self._envs = EnergyVectorEnv(1, robots=robots, **arguments)
        self.action_space = self._envs.single_action_space
        self.observation_space = self._envs.single_observation_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode. The same `seed` gives the same one."""
        super().reset(seed=seed)
        observations, infos = self._envs.reset(seed=int(self.np_random.integers(1 << 31)))
        return observations[0], _first(infos)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One step of 33 ms."""
        observations, rewards, terminated, truncated, infos = self._envs.step(np.asarray(action)[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(infos)


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    """Those of the first environment, without gymnasium's marks."""
    return {name: values[0] for name, values in infos.items() if not name.startswith("_")}


def _spaces(axis: tuple[int, ...]) -> tuple[Any, Any]:
    """Of observations and of actions, for each robot."""

    def box(low: list[float], high: list[float]) -> Any:
        ends = (np.broadcast_to(np.float32(end), (*axis, len(low))).copy() for end in (low, high))
        return gymnasium.spaces.Box(*ends, dtype=np.float32)

    x0, x1, y0, y1 = ARENA_M
    observations = box([x0, y0, -1.0, -1.0, x0, y0, 0.0, 0.0], [x1, y1, 1.0, 1.0, x1, y1, 1.0, POWER_MAX_W])
    return observations, box([-V_MAX_MPS, -OMEGA_MAX_RADPS], [V_MAX_MPS, OMEGA_MAX_RADPS])


def _limited(v: Any, omega: Any, xp: Any = np) -> tuple[Any, Any]:
    """What the wheels can do of it. `xp` is the module that computes, numpy or jax.numpy."""
    half = 0.5 * BASE_LENGTH_M * omega
    left = xp.clip((v - half) / WHEEL_RADIUS_M, -WHEEL_MAX_RADPS, WHEEL_MAX_RADPS)
    right = xp.clip((v + half) / WHEEL_RADIUS_M, -WHEEL_MAX_RADPS, WHEEL_MAX_RADPS)
    return 0.5 * WHEEL_RADIUS_M * (left + right), WHEEL_RADIUS_M / BASE_LENGTH_M * (right - left)


def _moved(poses: Any, v: Any, omega: Any, xp: Any) -> tuple[Any, Any, Any]:
    """The poses after a step, in the order of the Robotarium's simulator. Walls stop robots."""
    x, y, theta = poses
    x0, x1, y0, y1 = ARENA_M
    turned = theta + STEP_S * omega
    moved_x, moved_y = x + STEP_S * v * xp.cos(theta), y + STEP_S * v * xp.sin(theta)
    return xp.clip(moved_x, x0, x1), xp.clip(moved_y, y0, y1), xp.arctan2(xp.sin(turned), xp.cos(turned))


def _each(name: str, given: Any, robots: int, most: float = np.inf) -> np.ndarray:
    found = np.asarray(given, np.float64)
    # A battery of 0 J has no state of charge.
    low = found > 0.0 if most == np.inf else found >= 0.0
    if found.shape not in ((), (robots,)) or not (low & (found <= most) & np.isfinite(found)).all():
        bounds = f"0 to {most:g}" if most < np.inf else "finite numbers above 0"
        raise ValueError(f"{name} is {given}, allowed are {bounds}: one for all robots, or {robots}")
    return np.broadcast_to(found, (robots,)).copy()
