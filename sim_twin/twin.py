"""The twin: plant, cameras, boards and radio behind the Protocols of `testbed.core.ports`.

Time is virtual and advances only when the loop waits: lockstep, deterministic, as fast as the CPU.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from operator import is_not
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from sim_twin.board import Driver
from sim_twin.camera import Cameras, Film, Optics, photograph
from sim_twin.fault_injection import FaultInjector
from sim_twin.plant import Plant
from sim_twin.radio import Links, Radio, Whole, listen
from sim_twin.randomness import stream
from sim_twin.reference_bodies import ReferenceBodies
from testbed.core.bundle import Bundle, unpacked
from testbed.core.codes import FaultReport
from testbed.core.compiled import compiled, with_fixed_types
from testbed.core.fault_injection import Injection
from testbed.core.rows import (
    States,
    message_of,
    row_of_message,
    row_of_setpoint,
    setpoint_of,
)
from testbed.core.table import Obstacle, Table
from testbed.core.types import (
    ALL_WELL,
    Health,
    LawMessage,
    Pose,
    PoseSample,
    Setpoint,
    State,
    ValveCommand,
    Vitals,
)
from testbed.core.vehicle import Vehicle

Array = NDArray[np.float64]

HOST = "host"


class SensorPorts(NamedTuple):
    """What cameras, radio and sensors read and write, for compiled code."""

    film: Film
    optics: Optics
    states: Links  # for the vehicles' states
    setpoints: Links
    messages: Links  # of laws
    tanks: Array  # gas [kg], tank pressure, set pressure and dropout [Pa], see Air; (v, 4)
    used: Array  # gas consumed, (v,) [kg]
    gauges: Array  # pressure of supply and tank, written to [Pa], battery [V]; (v, 3)


@compiled
def observe(ports, times, states, shown, now):
    """What cameras, radio and sensors tell after a window of the plant.

    Args:
        ports: Bundle of SensorPorts.
        times: of the exposures, shape (m,) [s].
        states: the truth at these times, shape (m, v, 6).
        shown: vehicle that each body shows, see camera.photograph.
        now: [s].

    Returns:
        see camera.photograph.
    """
    it = unpacked(ports)
    most = photograph(it.film, it.optics, times, states, shown, now)
    listen(it.states, now)
    listen(it.setpoints, now)
    listen(it.messages, now)
    for k in range(it.used.shape[0]):
        gas, full, wanted, dropout = it.tanks[k]
        tank = full * max(0.0, gas - it.used[k]) / gas
        it.gauges[k, 0], it.gauges[k, 1] = max(0.0, min(wanted, tank - dropout)), tank
    return most


@compiled
def exposures(rate, phase, frame, t, times):
    """Write to `times` when the cameras expose their frames from number `frame` on, until `t` [s].

    Args:
        rate: of the cameras [Hz].
        phase: of their first frame, in frames.
        frame: number of the next frame.
        t: [s].
        times: written to [s].

    Returns:
        how many.
    """
    count = max(0, math.floor(t * rate - phase) + 1 - frame)
    for k in range(min(count, times.shape[0])):
        times[k] = (frame + k + phase) / rate
    return count


def law_of(name: str) -> str:
    """The law of a vehicle as a receiver of messages."""
    return f"the law of {name}"


class Twin:
    """One table with its vehicles. It is the run's Clock; the classes below are its other ports.

    `listeners` are the vehicles that subscribe to their neighbours' states. `drivers` replace the
    modelled boards and play the vehicles' plans.
    """

    def __init__(
        self,
        vehicles: Mapping[str, Vehicle],
        starts: Mapping[str, Pose],
        table: Table,
        obstacles: Mapping[str, Obstacle],
        seed: int,
        listeners: Collection[str] = (),
        drivers: Mapping[str, Driver] | None = None,
        injections: Sequence[Injection] = (),
    ) -> None:
        self.names = list(vehicles)
        self.rows = {name: k for k, name in enumerate(self.names)}
        self.plant = Plant(vehicles, starts, table, obstacles, seed, drivers)
        half = (table.size[0] / 2, table.size[1] / 2)
        self.injector = (
            FaultInjector(injections, self.plant, obstacles, half, seed) if injections else None
        )
        self.cameras = Cameras(self.names, table.mocap, seed, table.spread)
        self.states, self.setpoints = Radio(table.link, seed), Radio(table.link, seed)
        self.messages = Radio(table.link, seed)  # of laws
        self.now = 0.0  # time of the run [s]
        reference = table.lab.mocap.reference
        self._fixed = ReferenceBodies(reference, table.mocap, seed) if reference else None
        self.lab_fault: Callable[[], FaultReport | None] = lambda: None  # stops all vehicles
        self.rate = table.mocap.rate_hz  # of the cameras [Hz]
        self.phase = float(stream(seed, "camera phase").uniform(0.0, 1.0))  # in frames
        self.frame = 0  # number of the next one
        self.seen_at: list[float] = []  # of every camera frame so far [s]
        self.seen: list[Array] = []  # true states at these times, each (n, v, 6)
        self._listeners = frozenset(listeners)
        self.reach = table.link.range_m  # of the radio [m]; None: everywhere
        self.near = {n: [other for other in self.names if other != n] for n in self.names}
        self._audiences: dict[tuple[str, bool], Whole] = {}
        airs = [vehicle.air for vehicle in vehicles.values()]
        self._tanks = np.array([(a.gas, a.tank_pressure, a.set_pressure, a.dropout) for a in airs])
        # of each vehicle: supply and tank pressure [Pa], battery [V]
        self.gauges = np.empty((len(airs), 3))
        self.gauges[:, 2] = [vehicle.gauges.battery_v for vehicle in vehicles.values()]
        self.blackboard: dict[
            str, tuple[float, LawMessage, LawMessage | None]
        ] = {}  # of laws on the host
        self._sensor_ports: Bundle | None = None
        self._observe, self._exposures = with_fixed_types(observe), with_fixed_types(exposures)
        self._look(np.empty(0), np.empty((0, len(airs), 6)))

    def reseed(self, seed: int) -> None:
        """Draw other random numbers from now on; the vehicles stay as they were drawn."""
        self.cameras.reseed(self.names, seed)
        for radio in self.radios:
            radio.reseed(seed)
        for name, board in self.plant.boards.items():
            board.reseed(stream(seed, name, "pulses"))
        if self.injector is not None:
            self.injector.reseed(seed)

    def wait_until(self, t: float) -> None:
        """Advance the simulation to `t` [s]."""
        if t <= self.now:
            return
        times = np.empty(2 + int((t - self.now) * self.rate))
        times = times[: self._exposures(self.rate, self.phase, self.frame, t, times)]
        if self.injector is not None:
            self.injector.before(t)
        seen = self.plant.advance(t, times)
        self.note_window(t, times, seen)
        self._look(times, seen)

    def note_window(self, t: float, times: Array, seen: Array) -> None:
        """Note that the plant is at `t` [s], and its states at the cameras' exposures until then.

        Args:
            t: [s].
            times: of the exposures, (n,) [s].
            seen: true states at these times, (n, v, 6).
        """
        self.now, self.frame = t, self.frame + len(times)
        self.seen_at += times.tolist()
        self.seen.append(seen)

    @property
    def sensor_ports(self) -> Bundle:
        """Address of SensorPorts; another one once film or links have been replaced, to grow."""
        parts = (
            self.cameras.film, self.cameras.optics,
            self.states.links, self.setpoints.links, self.messages.links,
        )  # fmt: skip
        if self._sensor_ports is None or any(map(is_not, self._sensor_ports.value, parts)):
            self._sensor_ports = Bundle(
                SensorPorts(*parts, self._tanks, self.plant.used, self.gauges)
            )
        return self._sensor_ports

    def _look(self, times: Array, seen: Array) -> None:
        """Let cameras, radio and sensors follow the plant."""
        shown, broken = self.cameras.own, self.injector
        if broken is not None:
            broken.look(self.now)
            if (rows := broken.sources(self.names, times)) is not None:
                shown = np.array(rows, np.int64)
            for name in self.names:
                for radio in self.radios:
                    radio.disturb(name, *broken.radio(name))
        self.cameras.load(len(times))
        self.cameras.most = self._observe(self.sensor_ports, times, seen, shown, self.now)
        if self.reach is not None:
            self._update_ranges(self.reach)

    def _update_ranges(self, reach: float) -> None:
        """Find out which vehicles are in range of each other."""
        p = self.plant.x[:, :2]
        apart = np.linalg.norm(p[:, None] - p[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        for one, row in zip(self.names, apart, strict=True):
            near = [self.names[k] for k in np.flatnonzero(row <= reach).tolist()]
            if near != self.near[one]:
                for gone in set(self.near[one]).difference(near):
                    self.states.drop_link(one, gone)
                    self.messages.drop_link(one, law_of(gone))
                self.near[one] = near
                self._audiences.clear()

    def audience(self, name: str, *, laws: bool = False) -> Whole:
        """The links on which a vehicle sends its state, or its law's message."""
        rows = self._audiences.get((name, laws))
        if rows is None:
            receivers = [other for other in self.near[name] if other in self._listeners]
            to = [law_of(other) for other in receivers] if laws else [HOST, *receivers]
            radio = self.messages if laws else self.states
            rows = self._audiences[name, laws] = radio.rows((name, other) for other in to)
        return rows

    @property
    def radios(self) -> tuple[Radio, Radio, Radio]:
        """The links for each kind of message."""
        return self.states, self.setpoints, self.messages

    def vitals(self, name: str) -> Vitals:
        """Health of a vehicle's process; good unless a fault is injected."""
        vitals = ALL_WELL if self.injector is None else self.injector.vitals(name)
        fault = self.lab_fault()
        return vitals if fault is None else replace(vitals, fleet=fault)

    def reference_bodies(self) -> dict[str, PoseSample]:
        """The newest pose of each reference body."""
        return {} if self._fixed is None else self._fixed.seen(self.now, self.injector)

    def health(self, name: str) -> Health:
        """Readings of the board's sensors."""
        supply, tank, battery = self.gauges[self.rows[name]].tolist()
        if self.injector is None:
            return Health(self.now, supply, tank, battery)
        supply = self.injector.supply(name, supply)
        return Health(self.now, supply, tank, *self.injector.power(name, battery))


class TwinPoses:
    """PoseSource of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name, self._row = twin, name, twin.rows[name]

    def samples(self) -> Sequence[PoseSample]:
        """See `PoseSource`."""
        twin, samples = self._twin, self._twin.cameras.arrived(self._row)
        return samples if twin.injector is None else twin.injector.poses(self._name, samples)


class TwinThrusters:
    """Thrusters of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name, self._board = twin, name, twin.plant.boards[name]

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        self._board.apply(command)

    def land(self) -> None:
        """See `Thrusters`."""
        self._board.land()
        plant = self._twin.plant
        plant.land(plant.vehicle_of_board(self._twin.rows[self._name]))

    def health(self) -> Health:
        """See `Thrusters`."""
        return self._twin.health(self._name)


class TwinVehicleLink:
    """VehicleLink of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name, self._law = twin, name, law_of(name)

    def setpoint(self) -> Setpoint | None:
        """See `VehicleLink`."""
        found = self._twin.setpoints.newest(HOST, self._name)
        return None if found is None else setpoint_of(found)

    def neighbours(self) -> dict[str, State]:
        """See `VehicleLink`."""
        twin = self._twin
        return states_of(twin.states.received(self._name, twin.near[self._name]))

    def publish(self, state: State) -> None:
        """See `VehicleLink`."""
        twin = self._twin
        twin.states.send(twin.audience(self._name), twin.now, States.of([state]).rows[0])

    def messages(self) -> dict[str, LawMessage]:
        """See `VehicleLink`."""
        received = self._twin.messages.received(self._law, self._twin.near[self._name])
        return {name: message_of(row) for name, row in received.items()}

    def broadcast(self, message: LawMessage) -> None:
        """See `VehicleLink`."""
        twin = self._twin
        to = twin.audience(self._name, laws=True)
        twin.messages.send(to, twin.now, row_of_message(message))


class TwinHostLink:
    """HostLink of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name = twin, name
        self._audience = twin.setpoints.rows([(HOST, name)])
        self._others = [n for n in twin.names if n != name]

    def own(self) -> State | None:
        """See `HostLink`."""
        found = self._twin.states.newest(self._name, HOST)
        return None if found is None else States.struct(found.tolist())

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        return states_of(self._twin.states.received(HOST, self._others))

    def publish(self, setpoint: Setpoint) -> None:
        """See `HostLink`."""
        twin = self._twin
        twin.setpoints.send(self._audience, twin.now, row_of_setpoint(setpoint))

    def messages(self) -> dict[str, LawMessage]:
        """See `HostLink`. The laws share a computer and receive messages of earlier ticks."""
        messages = {}
        for name, (said_at, newest, before) in self._twin.blackboard.items():
            message = newest if said_at < self._twin.now else before
            if name != self._name and message is not None:
                messages[name] = message
        return messages

    def broadcast(self, message: LawMessage) -> None:
        """See `HostLink`."""
        board, now = self._twin.blackboard, self._twin.now
        _, newest, _ = board.get(self._name, (now, None, None))
        board[self._name] = (now, message, newest)


def states_of(received: Mapping[str, Array]) -> dict[str, State]:
    """The states in messages, by sender."""
    return {name: States.struct(row.tolist()) for name, row in received.items()}
