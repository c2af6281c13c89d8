"""Warns if a user's own law asks for more force at the start than a vehicle's jets give it."""

import math
from contextlib import suppress

import numpy as np

from controllers.own_law import OwnLawParams, own_law
from controllers.scale import Scaled
from testbed.config.experiment import Experiment
from testbed.core.error import TestbedError
from testbed.core.law import Body, Concern, Discs, Goal, Law, Neighbours, World
from testbed.core.path import Path
from testbed.flight.allocation import weakest_force
from testbed.realtime.law_watch import reading

STILL = np.zeros(2)
ROUNDING = 1.0 + 1e-6  # a law that limits its own force asks for no more


def asks_too_much(experiment: Experiment) -> list[Concern]:
    """The warning; it calls the law once for each vehicle."""
    params, demands = experiment.controller, dict[str, tuple[float, float]]()
    if not isinstance(params, OwnLawParams):
        return []
    with suppress(TestbedError), reading(params.law):  # the flight reports a law that fails
        for k, name in enumerate(experiment.vehicles):
            law = own_law(params, list(experiment.vehicles), 2, limited=False)
            demands[name] = _demand(experiment, k, Scaled(law, params.scale))
    beyond = {n: pair for n, pair in demands.items() if pair[0] > ROUNDING * pair[1]}
    if not beyond:
        return []
    worst = max(beyond, key=lambda name: beyond[name][0] / beyond[name][1])
    asked, most = beyond[worst]
    text = (
        f"at the start the law asks {worst} for {asked:.4g} N, and own.max_force is {most:.4g} N: "
        "a law in plain Python flies with a force limited to it, a compiled law must limit its own"
    )
    return [Concern("demand-beyond-thrust", text)]


def _demand(experiment: Experiment, k: int, law: Law) -> tuple[float, float]:
    """The force that the law asks for at rest at the start, and its limit [N]."""
    setups, guidance = list(experiment.vehicles.values()), experiment.guidance
    most = guidance.force_share * weakest_force(setups[k].model)
    starts = np.array([setup.start[:2] for setup in setups])
    others = np.array([j for j in range(len(setups)) if j != k], dtype=np.int64)
    n = len(others)
    neighbours = Neighbours(
        starts[others], np.zeros((n, 2)), np.full(n, guidance.neighbour_distance), others,
        np.zeros((n, law.message_size)), np.zeros(n),
    )  # fmt: skip
    obstacles = list(experiment.obstacles.values())
    discs = Discs(
        np.array([one.position for one in obstacles]).reshape(-1, 2),
        np.array([one.velocity for one in obstacles]).reshape(-1, 2),
        np.array([one.radius for one in obstacles]),
    )
    world = World(_goal(setups[k].goal, setups[k].path), discs)
    own = Body(starts[k], STILL, setups[k].model.mass, STILL, STILL, most, k)
    force, _ = law.rate(law.initial(own, neighbours, world), own, neighbours, world, 0.0)
    return math.hypot(*force.tolist()), most


def _goal(pose: tuple[float, float, float], path: Path | None) -> Goal:
    place = np.array(pose[:2])
    if path is None:
        return Goal(place, STILL, STILL, STILL)
    p, v, a, jerk = (np.array(value) for value in path.at(0.0))
    return Goal(place + p, v, a, jerk)
