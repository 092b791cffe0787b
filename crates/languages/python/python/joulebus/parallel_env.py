"""The environment for several learners: PettingZoo's parallel interface.

    from joulebus import EnergyParallelEnv     # needs pettingzoo and gymnasium

    env = EnergyParallelEnv(robots=3, chargers=[[0.0], [0.0]])
    observations, infos = env.reset(seed=7)
    observations, rewards, terminated, truncated, infos = env.step({agent: [0.1, 0.0] for agent in env.agents})
"""
from __future__ import annotations

from typing import Any

import numpy as np

from ._optional import needed
from .vector_env import EnergyVectorEnv, _first, _spaces

_pettingzoo = needed("pettingzoo", "parallel environments")


class EnergyParallelEnv(_pettingzoo.ParallelEnv):  # type: ignore[misc, name-defined]
    """One arena of `EnergyVectorEnv`, whose robots are agents: ``robot_0``, ``robot_1``, and so on.

    Arguments are those of `EnergyVectorEnv`. Each robot has its own observation ``(8,)``, action ``(2,)``, reward and
    infos. The episode ends for all at once.
    """

    metadata: dict[str, Any] = {"name": "joulebus_energy_v0", "render_modes": []}
    render_mode = None

    def __init__(self, robots: int = 2, **arguments: Any) -> None:
        self._envs = EnergyVectorEnv(1, robots=robots, **arguments)
        self.possible_agents = [f"robot_{robot}" for robot in range(robots)]
        self.agents: list[str] = []
        # Each agent has spaces of its own, which are seeded by themselves.
        self._spaces = {agent: _spaces(()) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Any:
        """Of one robot: as of `EnergyVectorEnv`."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> Any:
        """Of one robot: v (m/s) and omega (rad/s)."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begins an episode. The same `seed` gives the same one."""
        observations, infos = self._envs.reset(seed=seed)
        self.agents = self.possible_agents[:]
        return self._each(observations[0]), self._infos(infos)

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        """One step of 33 ms of all robots. One without an action stands still."""
        if not self.agents:
            raise RuntimeError("the episode has ended: call reset()")
        unknown = set(actions) - set(self.agents)
        if unknown:
            raise ValueError(f"there is no agent {unknown.pop()!r}, allowed are {', '.join(self.agents)}")
        wanted = [actions.get(agent, (0.0, 0.0)) for agent in self.possible_agents]
        rewards, step_j, terminated, truncated = self._envs._advance(np.asarray(wanted)[None])
        found = (
            self._each(self._envs._observations()[0]),
            self._each(rewards[0].tolist()),
            dict.fromkeys(self.agents, bool(terminated[0])),
            dict.fromkeys(self.agents, bool(truncated[0])),
            self._infos(self._envs._infos(step_j)),
        )
        if terminated[0] or truncated[0]:
            self.agents = []
        return found

    def render(self) -> None:
        """Nothing is drawn."""

    def _each(self, values: Any) -> dict[str, Any]:
        return dict(zip(self.possible_agents, values))

    def _infos(self, infos: dict[str, Any]) -> dict[str, dict[str, Any]]:
        first = _first(infos)
        return self._each({name: values[robot] for name, values in first.items()} for robot in range(self._envs.robots))
