"""Assembles a vehicle's flight chain from the experiment."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np

from controllers.catalogue import make_law
from testbed.config import Experiment
from testbed.core.types import Pose
from testbed.faults.law_faults import SpoiltLaw
from testbed.flight.agent import Agent
from testbed.flight.allocation import weakest_force
from testbed.flight.arming import Expected
from testbed.flight.barrier import Barrier, reaches
from testbed.flight.detectors import Detectors
from testbed.flight.estimator import Estimator
from testbed.flight.fault_monitor import FaultMonitor
from testbed.flight.gate import Fence, Gate
from testbed.flight.guidance import Guidance
from testbed.flight.jet_faults import JetFaultDetector
from testbed.flight.nearby import Nearby
from testbed.flight.safety import Safety
from testbed.metrics.formation import FormationContext
from testbed.realtime.law_watch import timed, watching


def watched(experiment: Experiment) -> AbstractContextManager[object]:
    """The timer for calls of the experiment's law, in the process that calls it."""
    deploy, period = experiment.deploy, experiment.flight.jet_period_s
    limit = deploy.call_limit(period)
    # the host calls the law for one vehicle after the other
    calls = len(experiment.vehicles) if deploy.law == "host" else 1
    return watching(experiment.controller, limit, deploy.law_memory_mb, period / calls)


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


SPARE_FORCE = 0.95  # of the weakest direction: margin for droop and weak jets


def make_barrier(experiment: Experiment, name: str, force_share: float = 1.0) -> Barrier | None:
    """One vehicle's safety filter, for a share of its jets' force; None: switched off.

    A reference model gets a smaller share and plans its stops with more of that share, because it
    has no errors.
    """
    params, setup = experiment.flight.barrier, experiment.vehicles[name]
    if not params.on:
        return None
    force = SPARE_FORCE * weakest_force(setup.model)
    radii = {other: one.model.radius for other, one in experiment.vehicles.items()}
    return Barrier(
        params,
        setup.model.mass,
        force_share * force,
        experiment.flight.jet_period_s,
        fence_of(experiment, name),
        experiment.obstacles,
        reaches(radii, name),
        effort=min(1.0, params.effort / force_share),
    )


def fence_of(experiment: Experiment, name: str) -> tuple[float, float]:
    """Largest distance of the vehicle's centre from the table's middle, in x and y [m]."""
    size, rim = experiment.table.size, experiment.vehicles[name].model.radius
    rim += experiment.flight.gate.fence_margin
    return size[0] / 2 - rim, size[1] / 2 - rim


def expected_of(experiment: Experiment, name: str) -> Expected:
    """Values that a vehicle's arming checks compare with."""
    setups = experiment.vehicles
    return Expected(
        name,
        experiment.table.mocap.rate_hz,
        setups[name].model.air.set_pressure,
        Fence(*fence_of(experiment, name)),
        setups[name].start,
        reaches({other: one.model.radius for other, one in setups.items()}, name),
    )


def make_detectors(experiment: Experiment, name: str) -> Detectors:
    """One vehicle's fault detectors."""
    vehicle, table = experiment.vehicles[name].model, experiment.table
    flight = experiment.flight
    evidence = JetFaultDetector(vehicle, flight.jet_period_s, flight.estimator, table)
    radii = {other: one.model.radius for other, one in experiment.vehicles.items()}
    nearby = Nearby(vehicle.radius, table.size, experiment.obstacles, reaches(radii, name))
    return Detectors(vehicle, evidence, nearby, noisy=table.mocap.noise > 0.0)


def make_safety(experiment: Experiment, name: str) -> Safety:
    """One vehicle's fault monitor, brake and safety filter."""
    vehicle, period = experiment.vehicles[name].model, experiment.flight.jet_period_s
    return Safety(
        vehicle,
        period,
        FaultMonitor(experiment.faults),
        make_detectors(experiment, name),
        make_barrier(experiment, name),
        SPARE_FORCE * weakest_force(vehicle) / vehicle.mass,
        experiment.flight.ending,
    )


def make_agent(experiment: Experiment, name: str, spoilt: Callable[[], str] | None = None) -> Agent:
    """One vehicle's flight chain."""
    flight, table, vehicle = experiment.flight, experiment.table, experiment.vehicles[name].model
    fence = Fence(*fence_of(experiment, name))
    blind = max(flight.gate.pose_timeout_s, flight.gate.blind_s) + table.mocap.latency_s
    memory = 2 + math.ceil(blind / flight.jet_period_s)
    on_board = experiment.deploy.law == "vehicle"
    return Agent(
        flight,
        vehicle,
        Estimator(flight.estimator, vehicle, table.mocap, memory),
        Gate(flight.gate, fence),
        make_guidance(experiment, name, spoilt) if on_board else None,
        make_safety(experiment, name),
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
