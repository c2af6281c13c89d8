"""Assembles a vehicle's flight chain from the experiment."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np

from controllers.catalogue import UsersLaw, make_law
from testbed.config import Experiment
from testbed.core.landing import brakes_shorter
from testbed.core.types import Pose
from testbed.faults.law_faults import SpoiltLaw
from testbed.flight.agent import Agent, lead_time
from testbed.flight.arming import Expected
from testbed.flight.barrier import Barrier, reaches
from testbed.flight.gate import Fence
from testbed.flight.guidance import Guidance
from testbed.flight.nearby import Nearby
from testbed.flight.parameters import make_parameters, stopping_force
from testbed.flight.pilot import Pilot
from testbed.metrics.formation import FormationContext
from testbed.realtime.law_watch import timed, watching


def watched(experiment: Experiment, *, slow: bool = True) -> AbstractContextManager[object]:
    """The timer for calls of the experiment's law, in the thread that calls it.

    Args:
        experiment: that is flown.
        slow: also judge whether the calls are fast enough for the bench and the table.
    """
    deploy, period = experiment.deploy, experiment.flight.jet_period_s
    limit = deploy.call_limit(period)
    # the host calls the law for one vehicle after the other
    calls = len(experiment.vehicles) if deploy.law == "host" else 1
    flown = [experiment.controller, *(one.controller for _, one in experiment.stages())]
    controller = next((one for one in flown if isinstance(one, UsersLaw)), flown[0])
    budget = period / calls if slow else math.inf
    return watching(controller, limit, deploy.law_memory_mb, budget)


def make_guidance(
    experiment: Experiment, name: str, spoilt: Callable[[], str] | None = None
) -> Guidance:
    """One vehicle's law and its world; `spoilt` injects faults of the law."""
    setup = experiment.vehicles[name]
    law = timed(lambda: make_law(experiment.controller, list(experiment.vehicles)), name)
    return Guidance(
        experiment.guidance,
        law if spoilt is None else SpoiltLaw(law, spoilt),
        setup.model,
        Pose(*setup.goal),
        list(experiment.obstacles.values()),
        experiment.flight.jet_period_s,
        name=name,
        formation=list(experiment.vehicles),
        path=setup.path,
        barrier=make_barrier(experiment, name, experiment.guidance.force_share),
    )


def make_pilot(experiment: Experiment, name: str) -> Pilot:
    """What flies a vehicle by hand, with the force and the filter of its law."""
    guidance, flight = experiment.guidance, experiment.flight
    barrier = make_barrier(experiment, name, guidance.force_share)
    speed = min(flight.gate.max_speed, flight.barrier.max_speed if barrier else math.inf)
    model = experiment.vehicles[name].model
    return Pilot(guidance, model, flight.jet_period_s, speed, barrier)


def brakes_first(experiment: Experiment, name: str) -> bool:
    """Whether in an emergency the jets stop this vehicle in less distance than landing does."""
    model = experiment.vehicles[name].model
    wait = experiment.flight.jet_period_s + lead_time(model)
    return brakes_shorter(model.landing, stopping_force(model) / model.mass, wait)


def make_barrier(experiment: Experiment, name: str, force_share: float = 1.0) -> Barrier | None:
    """One vehicle's safety filter, for a share of its jets' force; None: switched off.

    A reference model gets a smaller share and plans its stops with more of that share, because it
    has no errors.
    """
    params, setup = experiment.flight.barrier, experiment.vehicles[name]
    if not params.on:
        return None
    force = stopping_force(setup.model)
    radii = {other: one.model.radius for other, one in experiment.vehicles.items()}
    hard = {
        other: force_share * stopping_force(one.model) / one.model.mass
        for other, one in experiment.vehicles.items()
    }
    return Barrier(
        params,
        setup.model.mass,
        force_share * force,
        experiment.flight.jet_period_s,
        fence_of(experiment, name),
        experiment.obstacles,
        reaches(radii, name),
        effort=min(1.0, params.effort / force_share),
        hard=hard,
    )


def fence_of(experiment: Experiment, name: str) -> tuple[float, float]:
    """Largest distance of the vehicle's centre from the table's middle, in x and y [m]."""
    size, rim = experiment.table.size, experiment.vehicles[name].model.radius
    rim += experiment.flight.gate.fence_margin
    return size[0] / 2 - rim, size[1] / 2 - rim


def expected_of(experiment: Experiment, name: str) -> Expected:
    """Values that a vehicle's arming checks compare with."""
    setups, kept = experiment.vehicles, experiment.flight.barrier
    half = 0.5 * kept.vehicle_margin if len(setups) > 1 else kept.edge_margin
    return Expected(
        name,
        experiment.table.mocap.rate_hz,
        setups[name].model.air.set_pressure,
        setups[name].model.gauges.battery_v,
        Fence(*fence_of(experiment, name)),
        setups[name].start,
        reaches({other: one.model.radius for other, one in setups.items()}, name),
        min(kept.edge_margin, half),
    )


def make_agent(experiment: Experiment, name: str, spoilt: Callable[[], str] | None = None) -> Agent:
    """One vehicle's flight chain."""
    flight, table, vehicle = experiment.flight, experiment.table, experiment.vehicles[name].model
    fence, barrier = Fence(*fence_of(experiment, name)), make_barrier(experiment, name)
    blind = max(flight.gate.pose_timeout_s, flight.gate.blind_s) + table.mocap.latency_s
    radii = {other: one.model.radius for other, one in experiment.vehicles.items()}
    return Agent(
        make_parameters(flight, vehicle, table, experiment.faults, fence, barrier),
        lead_time(vehicle),
        2 + math.ceil(blind / flight.jet_period_s),
        experiment.faults,
        barrier,
        Nearby(vehicle.radius, table.size, experiment.obstacles, reaches(radii, name)),
        make_guidance(experiment, name, spoilt) if experiment.deploy.law == "vehicle" else None,
    )


def formation_context(experiment: Experiment) -> FormationContext:
    """The formation; its leader is the goal of the first vehicle with a path, else the first's."""
    setups = list(experiment.vehicles.values())
    led = next((setup for setup in setups if setup.path), setups[0])

    def leader(t: float) -> np.ndarray:
        start = np.array(led.goal[:2])
        return start if led.path is None else start + led.path.at(t).p

    return FormationContext(
        list(experiment.vehicles),
        np.array([setup.model.radius for setup in setups]),
        leader,
    )
