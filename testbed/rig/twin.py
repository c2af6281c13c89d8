"""The experiment on the twin."""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from sim_twin.board import Board, FirmwareBoard
from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.config import ConfigError, Experiment, Fork
from testbed.config.thresholds import vehicle_silent_s
from testbed.core.codes import FaultId, FaultReport
from testbed.core.fault_injection import ON_WIRES, Injection
from testbed.core.jets import JetHealth
from testbed.core.landing import landing_delay
from testbed.core.law import Concern
from testbed.core.ports import Clock, HostLink
from testbed.core.types import Pose
from testbed.core.warned import noticed
from testbed.faults.law_faults import CrashableNode
from testbed.flight.agent import Agent
from testbed.flight.arming import Check
from testbed.flight.frame_watch import FrameWatch
from testbed.flight.loop import (
    Chain,
    Ending,
    Observer,
    VehicleNode,
    come_to_rest,
    fly,
    hold,
)
from testbed.flight.safety import SPARE_S
from testbed.flight.supervisor import Supervisor
from testbed.metrics.afterwards import MINUTE, STEP, After, judge_after
from testbed.metrics.characterisation import characterise
from testbed.metrics.run_metrics import Consumption, Touch, Track
from testbed.rig.chain import brakes_first
from testbed.rig.firmware_boards import Valves, WiredBoard, make_drivers
from testbed.rig.fleet.fleet import Fleet, make_fleet
from testbed.rig.fleet.host import TwinHost
from testbed.rig.fleet.node import TwinNode
from testbed.rig.forked import SOON, ForkedAgent, ForkedHost, make_host, make_vehicle, stages
from testbed.rig.interface import holds, not_armed
from testbed.rig.live import LiveFlight
from testbed.rig.observers import NullObserver
from testbed.rig.readiness import twin_checks

WARM = 8  # ticks of a warm-up flight
LATER = 1e9  # never in a warm-up [s]


class Reseeding:
    """The flight's clock; after a fork with a seed the twin draws other numbers."""

    def __init__(self, forks: list[Fork], twin: Twin, clock: Clock) -> None:
        self._clock, self._twin = clock, twin
        self._seeds = deque((one.at_s, one.seed) for one in forks if one.seed is not None)

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        self._clock.wait_until(t)
        while self._seeds and t >= self._seeds[0][0] - SOON:
            self._twin.reseed(self._seeds.popleft()[1])


class TwinRig(Struct, frozen=True):
    """The experiment on the twin, ready to fly."""

    experiment: Experiment
    twin: Twin
    vehicles: list[TwinNode | VehicleNode | CrashableNode]
    hosts: list[ForkedHost]
    boards: dict[str, WiredBoard]  # with firmware; empty with the twin's model
    pace: Clock | None = None  # slows the twin down for a viewer
    supervisor: Supervisor = field(default_factory=Supervisor)
    red: list[Check] = field(default_factory=list)  # see `Rig`
    laws: list[ForkedHost | ForkedAgent] = field(default_factory=list)
    live: LiveFlight | None = None  # carries out the operator's requests
    fleet: Fleet | None = None  # flies many ticks ahead

    def fly(self, observer: Observer, stopped: Callable[[], int] = lambda: 0) -> Ending:
        """See `Rig`."""
        experiment, supervisor = self.experiment, self.supervisor
        checks = twin_checks(experiment, self.twin)
        if red := supervisor.take_off(0.0, checks):
            self.red.extend(red)
            return Ending(0.0, not_armed(red))
        ending = self.fly_unasked(observer, stopped)
        supervisor.close(ending.t, ending.fault, flown=ending.t >= experiment.end_s)
        return ending

    def fly_unasked(self, observer: Observer, stopped: Callable[[], int]) -> Ending:
        """Fly without the arming checks."""
        experiment = self.experiment
        clock: Clock = Reseeding(experiment.forks, self.twin, self.pace or self.twin)
        with ExitStack() as stack:
            if self.live is not None:
                flying = self.live.flying(clock, self.laws, self.hosts, self.supervisor)
                clock = stack.enter_context(flying)
            asked, ahead = self._ahead(observer, lambda: 2 if self._trouble() else stopped())
            ending = fly(
                clock, self.vehicles, self.hosts, experiment.flight.jet_period_s, experiment.ticks,
                observer, silent_s=vehicle_silent_s(experiment.table, experiment.flight),
                stopped=asked, ahead=ahead,
            )  # fmt: skip
        return replace(ending, fault=ending.fault or self._trouble())

    def _ahead(
        self, observer: Observer, stopped: Callable[[], int]
    ) -> tuple[Callable[[], int], Callable[[int], int]]:
        """`stopped` and `ahead` of `loop.fly`.

        A tick that has begun is finished before a stop.
        """
        fleet, show = self.fleet, getattr(observer, "ticks", None)
        if fleet is None or show is None or self.pace is not None or self.live is not None:
            return stopped, lambda k: 0
        last = self.experiment.ticks

        def ahead(k: int) -> int:
            span = None if fleet.pending or stopped() else fleet.fly(k, last)
            if span is None or not span.times:
                return 0
            show(span)
            return len(span.times)

        return lambda: 0 if fleet.pending else stopped(), ahead

    def come_to_rest(
        self, ending: Ending, observer: Observer, stopped: Callable[[], int] = lambda: 0
    ) -> After | None:
        """See `Rig`. The minute is simulated without cameras and plans."""
        if self.red:  # nothing has moved
            return None
        flight, twin, began = self.experiment.flight, self.twin, self.twin.now
        period = flight.jet_period_s
        # after a fault the last tick was at `began`, otherwise one period before
        first, ended_by = round(began / period) + (ending.fault is not None), None
        clock, models = self.pace or twin, self.experiment.vehicles

        def asked() -> int:
            return 2 if self._trouble() else stopped()

        if holds(self.experiment, ending):
            first, ended_by = hold(
                clock, self.vehicles, period, first, math.ceil(flight.ending.hold_s / period),
                observer, {name: one.model.air.set_pressure for name, one in models.items()},
                stopped=asked,
            )  # fmt: skip
        come_to_rest(
            clock, self.vehicles, period, first,
            math.ceil((flight.ending.brake_s + SPARE_S) / period), observer, stopped=asked,
            brakes=[name for name in models if brakes_first(self.experiment, name)],
        )  # fmt: skip
        return replace(self._minute(began, first * period), fault=ended_by)

    def _minute(self, began: float, rests: float) -> After:
        """Simulate the plant until a minute after `rests`, and judge it since `began` [s]."""
        twin, plant = self.twin, self.twin.plant
        braked = [at for at in twin.seen_at if at >= began]
        seen = np.concatenate([np.zeros((0, len(twin.names), 6)), *twin.seen])
        # by then the last plans have ended and every watchdog has acted
        models = [setup.model for setup in self.experiment.vehicles.values()]
        delays = [landing_delay(model.landing) for model in models]
        acted = twin.now + 1.0 + max((one for one in delays if one < MINUTE), default=0.0)
        period = self.experiment.flight.jet_period_s
        times, states = [np.array(braked)], [seen[len(seen) - len(braked) :]]
        stood = False
        while plant.t < rests + MINUTE and not stood:
            stood = plant.stands  # then this is the last window, and shows it
            boards = plant.t < acted
            until = min(plant.t + (period if boards else 1.0), rests + MINUTE)
            if twin.injector is not None:
                twin.injector.before(until)
            marks = np.arange(plant.t, until, STEP)
            states.append(plant.advance(until, marks, boards=boards))
            times.append(marks)
        floats = {name: plant.floats(k) for k, name in enumerate(plant.names)}
        return judge_after(
            plant.names, np.concatenate(times), np.concatenate(states), plant.touches, floats, began
        )

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """Valve outputs of each vehicle's board after `since` [s]; empty without firmware."""
        for name, board in self.twin.plant.boards.items():
            if isinstance(board, FirmwareBoard):
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

    def _trouble(self) -> FaultReport | None:
        """The first board that no longer executes plans, and why."""
        found = ((name, board.trouble) for name, board in self.boards.items())
        return next(
            (FaultReport(FaultId.BOARD_FAILED, why, name) for name, why in found if why), None
        )

    def concerns(self) -> list[Concern]:
        """See `Rig`."""
        nodes = [*self.vehicles, *self.hosts]
        of_laws = [
            Concern(concern.name, f"{node.name}: {concern.text}")
            for node in nodes
            if node.guidance is not None
            for concern in node.guidance.concerns
        ]
        return of_laws + noticed({node.name: node.warned for node in self.vehicles})

    def track(self) -> Track:
        """The truth at every camera frame so far."""
        twin = self.twin
        states = np.concatenate(twin.seen) if twin.seen else np.zeros((0, len(twin.names), 6))
        return Track(np.array(twin.seen_at), states)

    def truth(self) -> Iterator[tuple[str, list[float]]]:
        """Each vehicle and its true x, y, theta, vx, vy, omega now."""
        return zip(self.twin.names, self.twin.plant.x.tolist(), strict=True)

    def spent(self, name: str) -> Consumption:
        """See `Rig`."""
        plant = self.twin.plant
        k = plant.names.index(name)
        return Consumption(
            float(plant.impulse[k]), float(plant.used[k]), plant.boards[name].openings
        )

    def jets(self, name: str) -> tuple[JetHealth, ...]:
        """See `Rig`."""
        return next(one.jets for one in self.vehicles if one.name == name)

    @property
    def name(self) -> str:
        """See `Rig`."""
        return "twin"

    @property
    def now(self) -> float:
        """See `Rig`."""
        return self.twin.now

    @property
    def began_ns(self) -> int | None:
        """See `Rig`."""
        return None

    @property
    def touches(self) -> list[Touch]:
        """See `Rig`."""
        return [Touch(one.t, one.vehicle, one.other, one.speed) for one in self.twin.plant.touches]

    def wires(self) -> dict[str, Any]:
        """See `Rig`."""
        return {}


class WatchedFrame:
    """The twin's reference bodies, looked at once per tick."""

    def __init__(self, experiment: Experiment, twin: Twin) -> None:
        mocap = experiment.table.mocap
        self._watch = FrameWatch(experiment.table.lab.mocap.reference, mocap.noise)
        self._twin, self._at = twin, -math.inf

    def fault(self) -> FaultReport | None:
        """A frame that has moved."""
        if self._twin.now > self._at:
            self._watch.look(self._twin.reference_bodies())
            self._at = self._twin.now
        return self._watch.fault


def twin_node(twin: Twin, name: str, chain: Chain) -> VehicleNode:
    """A vehicle that lives on the twin."""
    link, vitals = TwinVehicleLink(twin, name), partial(twin.vitals, name)
    return VehicleNode(
        name, chain, TwinPoses(twin, name), TwinThrusters(twin, name), link, vitals
    )  # fmt: skip


def make_twin(
    experiment: Experiment,
    make_node: Callable[[Twin, str, Chain], VehicleNode] = twin_node,
    make_link: Callable[[Twin, str], HostLink] = TwinHostLink,
) -> TwinRig:
    """Build the twin rig of an experiment; the makers are those of `resumed.py`, or the twin's."""
    setups = experiment.vehicles
    for what in experiment.inject:
        if what.kind in ON_WIRES:
            expected = "a fault that can be injected on the twin, or the rig bench"
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
    if experiment.table.lab.mocap.reference:
        twin.lab_fault = WatchedFrame(experiment, twin).fault
    injector = twin.injector
    spoilt = {n: None if injector is None else partial(injector.spoilt, n) for n in setups}
    vehicles: list[TwinNode | VehicleNode | CrashableNode] = []
    laws: list[ForkedHost | ForkedAgent] = []
    for name, setup in setups.items():
        agent = make_vehicle(experiment, name, spoilt[name])
        if experiment.deploy.law == "vehicle" and isinstance(agent, ForkedAgent):
            laws.append(agent)
        node, board = make_node(twin, name, agent), twin.plant.boards[name]
        if injector is None:
            if make_node is twin_node and isinstance(agent, Agent) and isinstance(board, Board):
                vehicles.append(TwinNode(twin, agent, board, node))
            else:
                vehicles.append(node)
        else:
            jets = len(setup.model.jets)
            vehicles.append(CrashableNode(node, jets, partial(injector.dead, name)))
    hosts: list[ForkedHost] = []
    for name in setups if experiment.deploy.law == "host" else ():
        link = make_link(twin, name)
        kind = TwinHost if isinstance(link, TwinHostLink) else ForkedHost
        hosts.append(host := make_host(experiment, name, link, spoilt[name], kind))
        if isinstance(host, TwinHost):
            host.listen(twin)
    laws += hosts
    fleet = make_fleet(experiment, twin, vehicles, hosts)
    return TwinRig(experiment, twin, vehicles, hosts, drivers or {}, laws=laws, fleet=fleet)


def warm_up(experiment: Experiment, stopped: Callable[[], int] = lambda: 0) -> None:
    """Fly a few ticks of the experiment to rest, so that all code is compiled before the flight.

    A law is flown tick by tick at first (fleet/host.py), then many ticks are one call. At the end
    vehicles are flown tick by tick again: a stop must not wait for the compiler.
    """
    period = experiment.flight.jet_period_s
    for one in stages(experiment):
        # a law that a fault may spoil is flown in another way, also before the fault
        later = [Injection("nan_law", name, at_s=LATER) for name in one.vehicles if one.inject]
        brief = replace(one.flight, ending=replace(one.flight.ending, hold_s=WARM * period))
        short = replace(
            one, duration_s=WARM * period, board="model", inject=later, forks=[], flight=brief
        )
        rig = make_twin(short)
        ending = rig.fly_unasked(NullObserver(), stopped)  # arming checks do not matter here
        rig.come_to_rest(ending, NullObserver(), stopped)
    characterise(np.eye(2))  # compiles the metrics of a formation
