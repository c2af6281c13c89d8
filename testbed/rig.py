"""Who is plugged into what: the only module that knows everybody."""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from controllers.catalogue import make_law
from sim_twin.board import DrivenBoard
from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.boards import Valves, WiredBoard, make_drivers
from testbed.config import ConfigError, Experiment
from testbed.core.injection import ON_WIRES
from testbed.core.law import Concern
from testbed.core.ports import Clock
from testbed.core.types import HostTick, Pose, Tick
from testbed.flight.agent import Agent, lead_time
from testbed.flight.allocation import weakest_force
from testbed.flight.arming import Expected
from testbed.flight.barrier import Barrier, reaches
from testbed.flight.detectors import Detectors
from testbed.flight.estimator import Estimator
from testbed.flight.gate import Fence, Gate
from testbed.flight.guidance import Guidance
from testbed.flight.loop import Ending, HostNode, Observer, VehicleNode, fly
from testbed.flight.safety import Safety
from testbed.flight.supervisor import Supervisor
from testbed.flight.watch import Watch
from testbed.ops.characterisation import characterise
from testbed.ops.formation import Crew
from testbed.ops.metrics import Spent, Track
from testbed.ops.rehearsal import MortalNode, SpoiltLaw
from testbed.readiness import twin_checks


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


def expected_of(experiment: Experiment, name: str) -> Expected:
    """What a vehicle that wants to be armed is measured against."""
    setups = experiment.vehicles
    return Expected(
        name,
        experiment.table.mocap.rate_hz,
        setups[name].model.air.set_pressure,
        Fence(*fence_of(experiment, name)),
        reaches({other: one.model.radius for other, one in setups.items()}, name),
    )


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

    @property
    def supervisor(self) -> Supervisor:
        """Who may fire."""
        ...

    @property
    def red(self) -> list[str]:
        """Arming checks that kept the run from starting."""
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

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """What each vehicle's board drove after `since` [s], where it reports that."""
        ...

    @property
    def loop(self) -> tuple[float, float] | None:
        """How late the newest tick began and how long it took [s], by a real clock."""
        ...

    def paces(self) -> Iterator[tuple[str, float, Any]]:
        """What each vehicle said of its wires since the last call, and when, where it has any."""
        ...

    def spent(self, name: str) -> Spent:
        """What a vehicle has used so far."""
        ...

    def wires(self) -> dict[str, Any]:
        """What metrics.json says of the wires; nothing where there are none."""
        ...

    def concerns(self) -> list[Concern]:
        """What the laws have to say of the flight, where they run in this process."""
        ...


def not_armed(reasons: Sequence[str]) -> str:
    """What a run that was not started says instead of a fault."""
    return "not started: " + "; ".join(reasons)


class Nobody:
    """An observer that looks away."""

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""


def crew_of(experiment: Experiment) -> Crew:
    """Who flies; the leader is the goal of the first vehicle that has a path, or the first's."""
    setups = list(experiment.vehicles.values())
    led = next((setup for setup in setups if setup.path), setups[0])

    def leader(t: float) -> tuple[np.ndarray, np.ndarray]:
        start = np.array(led.goal[:2])
        if led.path is None:
            return start, np.zeros(2)
        moved = led.path.at(t)
        return start + moved.p, np.array(moved.v)

    return Crew(
        list(experiment.vehicles),
        np.array([setup.model.radius for setup in setups]),
        np.array([setup.model.mass for setup in setups]),
        experiment.guidance.force_share * min(weakest_force(setup.model) for setup in setups),
        leader,
    )


class TwinRig(Struct, frozen=True):
    """The experiment on the twin, ready to fly."""

    experiment: Experiment
    twin: Twin
    vehicles: list[VehicleNode | MortalNode]
    hosts: list[HostNode]
    boards: dict[str, WiredBoard]  # with firmware; empty with the twin's own
    pace: Clock | None = None  # slows the twin down, for whoever looks
    supervisor: Supervisor = field(default_factory=Supervisor)
    red: list[str] = field(default_factory=list)  # see `Rig`

    def fly(self, observer: Observer, stopped: Callable[[], bool] = lambda: False) -> Ending:
        """See `Rig`."""
        experiment, supervisor = self.experiment, self.supervisor
        checks = twin_checks(experiment, self.twin, partial(expected_of, experiment))
        if red := supervisor.take_off(0.0, checks):
            self.red.extend(red)
            return Ending(0.0, not_armed(red))
        ending = self.fly_unasked(observer, stopped)
        supervisor.close(ending.t, ending.fault, flown=ending.t >= experiment.end_s)
        return ending

    def fly_unasked(self, observer: Observer, stopped: Callable[[], bool]) -> Ending:
        """Fly, whatever the arming checks would say."""
        experiment = self.experiment
        ending = fly(
            self.pace or self.twin, self.vehicles, self.hosts, experiment.flight.jet_period_s,
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

    @property
    def loop(self) -> tuple[float, float] | None:
        """See `Rig`."""
        return None

    def paces(self) -> Iterator[tuple[str, float, Any]]:
        """See `Rig`."""
        return iter(())

    def _trouble(self) -> str | None:
        """The first board that does not play plans any more, and why."""
        found = ((name, board.trouble) for name, board in self.boards.items())
        return next((f"{name}: {trouble}" for name, trouble in found if trouble), None)

    def concerns(self) -> list[Concern]:
        """What the laws have to say of the flight."""
        nodes = [*self.vehicles, *self.hosts]
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
    for what in experiment.inject:
        if what.kind in ON_WIRES:
            expected = "a fault that a twin without wires can have, or --rig bench"
            raise ConfigError("this rig", "inject", expected, what.kind)
    models = {name: setup.model for name, setup in setups.items()}
    drivers = make_drivers(experiment.board, models)
    twin = Twin(
        models,
        {name: Pose(*setup.start) for name, setup in setups.items()},
        experiment.table,
        experiment.obstacles,
        experiment.seed,
        listeners=list(setups),
        drivers=drivers,
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
    return TwinRig(experiment, twin, vehicles, hosts, drivers or {})


def warm_up(experiment: Experiment, stopped: Callable[[], bool] = lambda: False) -> None:
    """Fly a few ticks of the experiment, so that everything is compiled before the clock runs."""
    period = experiment.flight.jet_period_s
    short = replace(experiment, duration_s=4 * period, board="model", inject=[])
    make_twin(short).fly_unasked(Nobody(), stopped)  # a red check is not about compiling
    characterise(np.eye(2))
