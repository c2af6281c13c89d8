"""Who is plugged into what: the only module that knows everybody."""

import math
from collections.abc import Callable, Iterator

import numpy as np
from msgspec import Struct

from controllers.catalogue import make_law
from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.config import Experiment
from testbed.core.law import Concern
from testbed.core.types import Pose
from testbed.flight.agent import Agent, lead_time
from testbed.flight.estimator import Estimator
from testbed.flight.gate import Fence, Gate
from testbed.flight.guidance import Guidance
from testbed.flight.loop import Ending, HostNode, Observer, VehicleNode, fly
from testbed.ops.metrics import Spent, Track


def make_guidance(experiment: Experiment, name: str) -> Guidance:
    """One vehicle's law and the world it is told about."""
    setup = experiment.vehicles[name]
    return Guidance(
        experiment.guidance,
        make_law(experiment.controller, list(experiment.vehicles)),
        setup.model,
        Pose(*setup.goal),
        list(experiment.obstacles.values()),
        experiment.flight.jet_period_s,
        name=name,
        formation=list(experiment.vehicles),
        path=setup.path,
    )


def make_agent(experiment: Experiment, name: str) -> Agent:
    """One vehicle's flight chain."""
    flight, table, vehicle = experiment.flight, experiment.table, experiment.vehicles[name].model
    rim = vehicle.radius + flight.gate.fence_margin
    fence = Fence(table.size[0] / 2 - rim, table.size[1] / 2 - rim)
    blind = flight.gate.pose_timeout_s + table.mocap.latency_s
    memory = 2 + math.ceil(blind / flight.jet_period_s)
    on_board = experiment.deploy.law == "vehicle"
    return Agent(
        flight,
        vehicle,
        Estimator(flight.estimator, vehicle, table.mocap, memory),
        Gate(flight.gate, fence),
        make_guidance(experiment, name) if on_board else None,
    )


class TwinRig(Struct, frozen=True):
    """The experiment on the twin, ready to fly."""

    experiment: Experiment
    twin: Twin
    vehicles: list[VehicleNode]
    hosts: list[HostNode]

    def fly(self, observer: Observer, stopped: Callable[[], bool] = lambda: False) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`."""
        experiment = self.experiment
        return fly(
            self.twin, self.vehicles, self.hosts, experiment.flight.jet_period_s,
            experiment.ticks, observer, stopped=stopped,
        )  # fmt: skip

    def concerns(self) -> list[Concern]:
        """What the laws have to say of the flight."""
        nodes: list[VehicleNode | HostNode] = [*self.vehicles, *self.hosts]
        return [
            Concern(concern.name, f"{node.name}: {concern.text}")
            for node in nodes
            if node.guidance is not None
            for concern in node.guidance.concerns
        ]

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
        listeners=list(setups) if experiment.deploy.law == "vehicle" else (),
    )
    period = experiment.flight.jet_period_s
    vehicles = [
        VehicleNode(
            name,
            make_agent(experiment, name),
            TwinPoses(twin, name),
            TwinThrusters(twin, name),
            TwinVehicleLink(twin, name),
        )
        for name in setups
    ]
    hosts = [
        HostNode(
            name,
            make_guidance(experiment, name),
            TwinHostLink(twin, name),
            period,
            lead_time(setup.model),
        )
        for name, setup in setups.items()
        if experiment.deploy.law == "host"
    ]
    return TwinRig(experiment, twin, vehicles, hosts)
