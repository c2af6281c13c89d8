"""Who is plugged into what: the only module that knows everybody."""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from controllers.catalogue import make_law
from sim_twin.board import DrivenBoard
from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.boards import Valves, WiredBoard, make_drivers
from testbed.config import Experiment
from testbed.core.types import HostTick, Pose, Tick
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


class Rig(Protocol):
    """An experiment on a rig, ready to fly."""

    @property
    def experiment(self) -> Experiment:
        """What is flown."""
        ...

    @property
    def name(self) -> str:
        """Of the rig."""
        ...

    @property
    def now(self) -> float:
        """Time of the run [s]."""
        ...

    @property
    def contacts(self) -> int:
        """Touches so far, as far as anybody can know."""
        ...

    def fly(self, observer: Observer, stopped: Callable[[], bool] = lambda: False) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`."""
        ...

    def track(self) -> Track:
        """Where the vehicles really were so far, or what comes nearest to it."""
        ...

    def truth(self) -> Iterator[tuple[str, list[float]]]:
        """Each vehicle and its true x, y, theta, vx, vy, omega now, where somebody knows."""
        ...

    def spent(self, name: str) -> Spent:
        """What a vehicle has used so far."""
        ...

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """Each change of valve outputs after `since`, where firmware drives them."""
        ...

    def wires(self) -> dict[str, Any]:
        """What metrics.json says of the wires; nothing where there are none."""
        ...


class Nobody:
    """An observer that looks away."""

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""


class TwinRig(Struct, frozen=True):
    """The experiment on the twin, ready to fly."""

    experiment: Experiment
    twin: Twin
    vehicles: list[VehicleNode]
    hosts: list[HostNode]
    boards: dict[str, WiredBoard]  # with firmware; empty with the twin's own

    def fly(self, observer: Observer, stopped: Callable[[], bool] = lambda: False) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`."""
        experiment = self.experiment
        ending = fly(
            self.twin, self.vehicles, self.hosts, experiment.flight.jet_period_s,
            experiment.ticks, observer, stopped=lambda: bool(self._trouble()) or stopped(),
        )  # fmt: skip
        return Ending(ending.t, ending.fault or self._trouble())

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """What each vehicle's board drove after `since` [s]; nothing with the twin's own."""
        for name, board in self.twin.plant.boards.items():
            if isinstance(board, DrivenBoard):
                new = bisect_right(board.edges, round(since * 1e6), key=lambda edge: edge[0])
                for at_us, mask in board.edges[new:]:
                    yield name, Valves(at_us * 1e-6, mask)

    def _trouble(self) -> str | None:
        """The first board that does not play plans any more, and why."""
        found = ((name, board.trouble) for name, board in self.boards.items())
        return next((f"{name}: {trouble}" for name, trouble in found if trouble), None)

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

    @property
    def name(self) -> str:
        """See `Rig`."""
        return "twin"

    @property
    def now(self) -> float:
        """See `Rig`."""
        return self.twin.now

    @property
    def contacts(self) -> int:
        """See `Rig`."""
        return len(self.twin.plant.touches)

    def wires(self) -> dict[str, Any]:
        """See `Rig`."""
        return {}


def make_twin(experiment: Experiment) -> TwinRig:
    """Everything of the experiment on the twin."""
    setups = experiment.vehicles
    models = {name: setup.model for name, setup in setups.items()}
    drivers = make_drivers(experiment.board, models)
    twin = Twin(
        models,
        {name: Pose(*setup.start) for name, setup in setups.items()},
        experiment.table,
        experiment.obstacles,
        experiment.seed,
        listeners=list(setups) if experiment.deploy.law == "vehicle" else (),
        drivers=drivers,
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
    return TwinRig(experiment, twin, vehicles, hosts, drivers or {})


def warm_up(experiment: Experiment, stopped: Callable[[], bool] = lambda: False) -> None:
    """Fly a few ticks of the experiment, so that everything is compiled before the clock runs."""
    short = replace(experiment, duration_s=4 * experiment.flight.jet_period_s, board="model")
    make_twin(short).fly(Nobody(), stopped)
