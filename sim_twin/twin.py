"""The twin: plant, cameras, boards and air waves behind the Protocols of `testbed.core.ports`.

Time is virtual and moves only when the loop waits: lockstep, deterministic, as fast as the CPU.
"""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_twin.board import Driver
from sim_twin.camera import Camera
from sim_twin.channel import Channel, RadioMedium
from sim_twin.fault_injection import Sabotage
from sim_twin.plant import Plant
from sim_twin.randomness import stream
from testbed.core.fault_injection import Injection
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


class Twin:
    """One table with its vehicles. It is the run's Clock; the ports below are its other faces.

    `listeners` are the vehicles that subscribe to their neighbours' states. `drivers` play the
    plans of each vehicle instead of the modelled boards.
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
        self._rows = {name: k for k, name in enumerate(self.names)}
        self.vehicles = vehicles
        self.plant = Plant(vehicles, starts, table, obstacles, seed, drivers)
        half = (table.size[0] / 2, table.size[1] / 2)
        self.sabotage = (
            Sabotage(injections, self.plant, obstacles, half, seed) if injections else None
        )
        self.cameras = {n: Camera(table.mocap, stream(seed, n, "camera")) for n in self.names}
        self.now = 0.0  # time of the run [s]
        self._rate = table.mocap.rate_hz
        self._phase = float(stream(seed, "camera phase").uniform(0.0, 1.0))
        self._frame = 0
        self.seen_at: list[float] = []  # of every camera frame so far [s]
        self.seen: list[Array] = []  # true states then, each (n, v, 6)
        link = table.link

        def channel(sender: str, receiver: str) -> Channel:
            return Channel(link, stream(seed, "link", sender, "to", receiver))

        self.listeners = frozenset(listeners)
        self.setpoints = {n: channel("host", n) for n in self.names}
        self.to_host: RadioMedium[State] = RadioMedium(channel)
        self.states: RadioMedium[State] = RadioMedium(channel)
        self.messages: RadioMedium[LawMessage] = RadioMedium(
            lambda a, b: channel(a, f"the law of {b}")
        )
        self._reach = link.range_m
        self._near_at = -math.inf
        self._near = {n: [other for other in self.names if other != n] for n in self.names}
        self.blackboard: dict[
            str, tuple[float, LawMessage, LawMessage | None]
        ] = {}  # of laws on the host

    def wait_until(self, t: float) -> None:
        """Let the world move on to `t`."""
        if t <= self.now:
            return
        last = math.floor(t * self._rate - self._phase)
        frames = range(self._frame, last + 1)
        self._frame = max(self._frame, last + 1)
        exposed = [(frame + self._phase) / self._rate for frame in frames]
        times = np.array(exposed, dtype=np.float64)
        if self.sabotage is not None:
            self.sabotage.before(t)
        seen = self.plant.advance(t, times)
        self.now = t
        self.seen_at += exposed
        self.seen.append(seen)
        shown = seen
        if self.sabotage is not None:
            self.sabotage.look(t)
            if (rows := self.sabotage.sources(self.names, times)) is not None:
                shown = np.stack([one[row] for one, row in zip(seen, rows, strict=True)])
        for k, name in enumerate(self.names):
            self.cameras[name].expose(times, shown[:, k])

    def near(self, name: str) -> list[str]:
        """The others that `name` hears now, and that hear it."""
        if self._reach is not None and self._near_at != self.now:
            p, self._near_at = self.plant.x[:, :2], self.now
            apart = np.linalg.norm(p[:, None] - p[None], axis=2)
            np.fill_diagonal(apart, np.inf)
            for one, row in zip(self.names, apart, strict=True):
                near = [self.names[k] for k in np.flatnonzero(row <= self._reach).tolist()]
                for gone in set(self._near[one]).difference(near):
                    self.states.part(one, gone)
                    self.messages.part(one, gone)
                self._near[one] = near
        return self._near[name]

    def trouble(self, receiver: str) -> tuple[float, float]:
        """Injected delay and loss of messages to a vehicle."""
        return (0.0, 0.0) if self.sabotage is None else self.sabotage.air(receiver)

    def vitals(self, name: str) -> Vitals:
        """What the process round a vehicle's chain knows; all is well in a twin, but for faults."""
        return ALL_WELL if self.sabotage is None else self.sabotage.vitals(name)

    def health(self, name: str) -> Health:
        """What the board's sensors read."""
        k = self._rows[name]
        air = self.vehicles[name].air
        left = air.gas - float(self.plant.used[k])
        pressures = air.supply_pressure(left), air.pressure_in_tank(left)
        if self.sabotage is None:
            return Health(self.now, *pressures)
        return Health(self.now, *pressures, *self.sabotage.power(name))


class TwinPoses:
    """PoseSource of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name, self._camera = twin, name, twin.cameras[name]

    def samples(self) -> Sequence[PoseSample]:
        """See `PoseSource`."""
        twin, samples = self._twin, self._camera.arrived(self._twin.now)
        return samples if twin.sabotage is None else twin.sabotage.poses(self._name, samples)


class TwinThrusters:
    """Thrusters of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name, self._board = twin, name, twin.plant.boards[name]

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        self._board.apply(command)

    def land(self) -> None:
        """See `Thrusters`."""
        plant = self._twin.plant
        self._board.land()
        plant.land(plant.names.index(self._name))

    def health(self) -> Health:
        """See `Thrusters`."""
        return self._twin.health(self._name)


class TwinVehicleLink:
    """VehicleLink of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name = twin, name
        self._setpoints, self._to_host = twin.setpoints[name], twin.to_host.between(name, "host")

    def setpoint(self) -> Setpoint | None:
        """See `VehicleLink`."""
        return self._setpoints.newest(self._twin.now)

    def neighbours(self) -> dict[str, State]:
        """See `VehicleLink`."""
        twin, own = self._twin, self._name
        return twin.states.heard(own, twin.near(own), twin.now)

    def publish(self, state: State) -> None:
        """See `VehicleLink`."""
        twin, now = self._twin, self._twin.now
        self._to_host.send(now, state)
        for other in twin.near(self._name):
            if other in twin.listeners:
                twin.states.between(self._name, other).send(now, state, twin.trouble(other))

    def messages(self) -> dict[str, LawMessage]:
        """See `VehicleLink`."""
        twin, own = self._twin, self._name
        return twin.messages.heard(own, twin.near(own), twin.now)

    def broadcast(self, message: LawMessage) -> None:
        """See `VehicleLink`."""
        twin = self._twin
        for other in twin.near(self._name):
            if other in twin.listeners:
                twin.messages.between(self._name, other).send(twin.now, message)


class TwinHostLink:
    """HostLink of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name = twin, name
        self._own = twin.to_host.between(name, "host")
        self._others = [n for n in twin.names if n != name]

    def own(self) -> State | None:
        """See `HostLink`."""
        return self._own.newest(self._twin.now)

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        return self._twin.to_host.heard("host", self._others, self._twin.now)

    def publish(self, setpoint: Setpoint) -> None:
        """See `HostLink`."""
        twin = self._twin
        twin.setpoints[self._name].send(twin.now, setpoint, twin.trouble(self._name))

    def messages(self) -> dict[str, LawMessage]:
        """See `HostLink`. The laws share a computer, and hear what was said before this tick."""
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
