"""A PettingZoo environment of several vehicles, which act at the same time."""

from typing import Any

from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from testbed.config import Experiment
from testbed.core.error import TestbedError
from testbed.env import action as actions
from testbed.env import observation as observations
from testbed.env.table import A_RESET, space_of
from testbed.env.world import World
from testbed.run.arguments import check_experiment

Each = dict[str, Any]


class FleetEnv(ParallelEnv[str, Any, Any]):
    """Several vehicles on the twin; a step is one jet period. For the arguments see `World`.

    What ends one vehicle's flight ends the episode of all, as a fault of one stops all in flight.
    """

    metadata = {"render_modes": [], "name": "testbed_fleet_v0"}  # noqa: RUF012  (as PettingZoo does)

    def __init__(
        self, experiment: Experiment, action: actions.Kind = "force",
        observation: observations.Layout = "pose", *,
        randomise: bool = True, anywhere: bool = False,
    ) -> None:  # fmt: skip
        check_experiment("FleetEnv", experiment)
        self._world = World(experiment, action, observation, randomise=randomise, anywhere=anywhere)
        self.possible_agents = list(experiment.vehicles)
        self.agents: list[str] = []
        self.observation_spaces = {
            name: space_of(observation, experiment, name) for name in experiment.vehicles
        }
        self.action_spaces = {
            name: actions.space_of(action, setup.model)
            for name, setup in experiment.vehicles.items()
        }
        self._rng: Any = None

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """See `ParallelEnv`."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """See `ParallelEnv`."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Each | None = None) -> tuple[Each, Each]:
        """See `ParallelEnv`; there are no options."""
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(seed)
        self._world.reset(self._rng)
        self.agents = list(self.possible_agents)
        return self._each(self._world.seen), self._each(self._world.info)

    def step(self, actions: Each) -> tuple[Each, Each, Each, Each, Each]:
        """See `ParallelEnv`.

        Raises:
            TestbedError: an agent has no action of the right shape, or the episode is over.
        """
        world = self._world
        if self._rng is not None and not self.agents:
            raise TestbedError(where="step", expected=A_RESET, found="no agents")
        world.step(actions)
        ended = any(world.ended(name) for name in self.agents)
        info = (
            self._each(world.seen), self._each(world.reward), dict.fromkeys(self.agents, ended),
            dict.fromkeys(self.agents, world.late), self._each(world.info),
        )  # fmt: skip
        if ended or world.late:
            self.agents = []
        return info

    def _each(self, of: Any) -> Each:
        return {name: of(name) for name in self.agents}
