"""A Gymnasium environment of one vehicle."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from testbed.config import Experiment
from testbed.core.error import TestbedError
from testbed.env import action as actions
from testbed.env import observation as observations
from testbed.env.world import World
from testbed.run.arguments import check_experiment

A_RESET = "a `reset`, because the episode has ended"


class TableEnv(gymnasium.Env[Any, Any]):
    """One vehicle on the twin; a step is one jet period. For the arguments see `World`."""

    metadata = {"render_modes": []}  # noqa: RUF012  (as Gymnasium declares it)

    def __init__(
        self, experiment: Experiment, action: actions.Kind = "force",
        observation: observations.Layout = "goal", *,
        randomise: bool = True, anywhere: bool = False,
    ) -> None:  # fmt: skip
        check_experiment("TableEnv", experiment)
        if len(experiment.vehicles) != 1:
            raise TestbedError(
                where="TableEnv", expected="an experiment with one vehicle; FleetEnv has several",
                found=f"{len(experiment.vehicles)} vehicles",
            )  # fmt: skip
        self._world = World(experiment, action, observation, randomise=randomise, anywhere=anywhere)
        (self._name,), (setup,) = experiment.vehicles, experiment.vehicles.values()
        self.observation_space = space_of(observation, experiment, self._name)
        self.action_space = actions.space_of(action, setup.model)
        self._ended = ""  # why the episode is over

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.Env`; there are no options."""
        super().reset(seed=seed)
        self._world.reset(self.np_random)
        self._ended = ""
        return self._world.seen(self._name), self._world.info(self._name)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env`.

        Raises:
            TestbedError: the action has another shape, or the episode is over.
        """
        world, name = self._world, self._name
        if self._ended:
            raise TestbedError(where="step", expected=A_RESET, found=f"a {self._ended}")
        world.step({name: action})
        self._ended = world.ended(name)
        return (
            world.seen(name), world.reward(name), bool(self._ended), world.late, world.info(name),
        )  # fmt: skip


def space_of(layout: observations.Layout, experiment: Experiment, name: str) -> spaces.Space[Any]:
    """The observation space of a vehicle of the experiment."""
    space = observations.space_of(layout, experiment.vehicles[name].model)
    if layout != "pose":
        return space
    discs = len(experiment.obstacles) + len(experiment.vehicles) - 1
    assert space.shape is not None
    return spaces.Box(-np.inf, np.inf, (space.shape[0] + 5 * discs,), np.float32)
