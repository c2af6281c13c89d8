"""Who is plugged into what: the only module that knows everybody."""

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from msgspec import Struct

from controllers.catalogue import make_law
from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.config import Experiment
from testbed.core.types import Pose
from testbed.flight.agent import Agent, lead_time
from testbed.flight.barrier import Barrier, reaches
from testbed.flight.detectors import Detectors
from testbed.flight.estimator import Estimator
from testbed.flight.gate import Fence, Gate
from testbed.flight.guidance import Guidance, weakest_force
from testbed.flight.loop import Ending, HostNode, Observer, VehicleNode, fly
from testbed.flight.safety import Safety
from testbed.flight.watch import Watch
from testbed.ops.metrics import Spent, Track
from testbed.ops.rehearsal import MortalNode, SpoiltLaw


def make_guidance(
    experiment: Experiment, name: str, spoilt: Callable[[], str] | None = None
) -> Guidance:
    """One vehicle's law and the world it is told about; `spoilt` is for rehearsals."""
    setup = experiment.vehicles[name]
    law = make_law(experiment.controller, list(experiment.vehicles))
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


SPARE_FORCE = 0.95  # of the weakest direction: droop, and a jet that is weaker than its file


def make_barrier(experiment: Experiment, name: str, force_share: float = 1.0) -> Barrier | None:
    """One vehicle's safety filter, for a share of what its jets can do; None: switched off.

    A reference model has a smaller share, and plans its stops with more of it: it has no errors.
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
    """Where the vehicle's centre may be, either way from the middle [m]."""
    size, rim = experiment.table.size, experiment.vehicles[name].model.radius
    rim += experiment.flight.gate.fence_margin
    return size[0] / 2 - rim, size[1] / 2 - rim


def make_safety(experiment: Experiment, name: str) -> Safety:
    """One vehicle's watch, brake and filter."""
    vehicle, period = experiment.vehicles[name].model, experiment.flight.jet_period_s
    return Safety(
        vehicle,
        period,
        Watch(experiment.faults),
        Detectors(vehicle, period, noisy=experiment.table.mocap.noise > 0.0),
        make_barrier(experiment, name),
        SPARE_FORCE * weakest_force(vehicle) / vehicle.mass,
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


class TwinRig(Struct, frozen=True):
    """The experiment on the twin, ready to fly."""

    experiment: Experiment
    twin: Twin
    vehicles: list[VehicleNode | MortalNode]
    hosts: list[HostNode]

    def fly(self, observer: Observer, stopped: Callable[[], bool] = lambda: False) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`."""
        experiment = self.experiment
        return fly(
            self.twin, self.vehicles, self.hosts, experiment.flight.jet_period_s,
            experiment.ticks, observer, stopped=stopped,
        )  # fmt: skip

    def track(self) -> Track:
        """The truth at every camera frame so far."""
        twin = self.twin
        states = np.concatenate(twin.seen) if twin.seen else np.zeros((0, len(twin.names), 6))
        return Track(np.array(twin.seen_at), states)

    def truth(self) -> Iterator[tuple[str, list[float]]]:
        """Each vehicle and its true x, y, theta, vx, vy, omega now."""
        return zip(self.twin.names, self.twin.plant.x.tolist(), strict=True)

    def spent(self, name: str) -> Spent:
        """What a vehicle has used so far."""
        plant = self.twin.plant
        k = plant.names.index(name)
        return Spent(float(plant.impulse[k]), float(plant.used[k]), plant.boards[name].openings)


def make_twin(experiment: Experiment) -> TwinRig:
    """Everything of the experiment on the twin."""
    setups = experiment.vehicles
    twin = Twin(
        {name: setup.model for name, setup in setups.items()},
        {name: Pose(*setup.start) for name, setup in setups.items()},
        experiment.table,
        experiment.obstacles,
        experiment.seed,
        listeners=list(setups),
        injections=experiment.inject,
    )
    period = experiment.flight.jet_period_s
    sabotage = twin.sabotage
    spoilt = {n: None if sabotage is None else partial(sabotage.spoilt, n) for n in setups}
    vehicles: list[VehicleNode | MortalNode] = []
    for name, setup in setups.items():
        node = VehicleNode(
            name,
            make_agent(experiment, name, spoilt[name]),
            TwinPoses(twin, name),
            TwinThrusters(twin, name),
            TwinVehicleLink(twin, name),
            partial(twin.vitals, name),
        )
        if sabotage is None:
            vehicles.append(node)
        else:
            jets = len(setup.model.jets)
            vehicles.append(MortalNode(node, jets, partial(sabotage.dead, name)))
    hosts = [
        HostNode(
            name,
            make_guidance(experiment, name, spoilt[name]),
            TwinHostLink(twin, name),
            period,
            lead_time(setup.model),
        )
        for name, setup in setups.items()
        if experiment.deploy.law == "host"
    ]
    return TwinRig(experiment, twin, vehicles, hosts)
