"""The twin: plant, cameras, boards and air waves behind the Protocols of `testbed.core.ports`.

Time is virtual and moves only when the loop waits: lockstep, deterministic, as fast as the CPU.
"""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_twin.board import Driver
from sim_twin.camera import Camera
from sim_twin.channel import Channel
from sim_twin.plant import Plant
from sim_twin.randomness import stream
from testbed.core.table import Obstacle, Table
from testbed.core.types import Health, Pose, PoseSample, Setpoint, State, Told, ValveCommand
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
    ) -> None:
        self.names = list(vehicles)
        self.vehicles = vehicles
        self.plant = Plant(vehicles, starts, table, obstacles, seed, drivers)
        self.cameras = {n: Camera(table.mocap, stream(seed, n, "camera")) for n in self.names}
        self._rate = table.mocap.rate_hz
        self._phase = float(stream(seed, "camera phase").uniform(0.0, 1.0))
        self._frame = 0
        self.seen_at: list[float] = []  # of every camera frame so far [s]
        self.seen: list[Array] = []  # true states then, each (n, v, 6)
        link = table.link

        def channel(sender: str, receiver: str) -> Channel:
            return Channel(link, stream(seed, "link", sender, "to", receiver))

        self.setpoints = {n: channel("host", n) for n in self.names}
        self.to_host = {n: channel(n, "host") for n in self.names}
        self.between = {
            (a, b): channel(a, b)
            for a in self.names
            for b in self.names
            if a != b and b in listeners
        }
        self.words = {pair: channel(pair[0], f"the law of {pair[1]}") for pair in self.between}
        self.blackboard: dict[str, tuple[float, Told, Told | None]] = {}  # of laws on the host

    @property
    def now(self) -> float:
        """Time of the run [s]."""
        return self.plant.t

    def wait_until(self, t: float) -> None:
        """Let the world move on to `t`."""
        if t <= self.now:
            return
        last = math.floor(t * self._rate - self._phase)
        frames = np.arange(self._frame, last + 1)
        self._frame = max(self._frame, last + 1)
        times = ((frames + self._phase) / self._rate).astype(np.float64)
        seen = self.plant.advance(t, times)
        self.seen_at += times.tolist()
        self.seen.append(seen)
        for k, name in enumerate(self.names):
            self.cameras[name].expose(times, seen[:, k])

    def health(self, name: str) -> Health:
        """What the board's sensors read."""
        k = self.names.index(name)
        air, metal = self.vehicles[name].air, self.plant.metal
        left = metal.gas[k] - self.plant.used[k]
        share = self.plant.supply_share(k)
        return Health(self.now, share * air.set_pressure, air.pressure_in_tank(float(left)))


class TwinPoses:
    """PoseSource of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._camera = twin, twin.cameras[name]

    def samples(self) -> Sequence[PoseSample]:
        """See `PoseSource`."""
        return self._camera.arrived(self._twin.now)


class TwinThrusters:
    """Thrusters of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name, self._board = twin, name, twin.plant.boards[name]

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        self._board.apply(command)

    def health(self) -> Health:
        """See `Thrusters`."""
        return self._twin.health(self._name)


class TwinVehicleLink:
    """VehicleLink of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name = twin, name

    def setpoint(self) -> Setpoint | None:
        """See `VehicleLink`."""
        return self._twin.setpoints[self._name].newest(self._twin.now)

    def neighbours(self) -> dict[str, State]:
        """See `VehicleLink`."""
        twin, own = self._twin, self._name
        heard = {a: air.newest(twin.now) for (a, b), air in twin.between.items() if b == own}
        return {name: state for name, state in heard.items() if state is not None}

    def publish(self, state: State) -> None:
        """See `VehicleLink`."""
        twin = self._twin
        twin.to_host[self._name].send(twin.now, state)
        for (sender, _), air in twin.between.items():
            if sender == self._name:
                air.send(twin.now, state)

    def told(self) -> dict[str, Told]:
        """See `VehicleLink`."""
        twin, own = self._twin, self._name
        heard = {a: air.newest(twin.now) for (a, b), air in twin.words.items() if b == own}
        return {name: told for name, told in heard.items() if told is not None}

    def tell(self, told: Told) -> None:
        """See `VehicleLink`."""
        for (sender, _), air in self._twin.words.items():
            if sender == self._name:
                air.send(self._twin.now, told)


class TwinHostLink:
    """HostLink of one vehicle."""

    def __init__(self, twin: Twin, name: str) -> None:
        self._twin, self._name = twin, name

    def own(self) -> State | None:
        """See `HostLink`."""
        return self._twin.to_host[self._name].newest(self._twin.now)

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        twin = self._twin
        heard = {n: twin.to_host[n].newest(twin.now) for n in twin.names if n != self._name}
        return {name: state for name, state in heard.items() if state is not None}

    def publish(self, setpoint: Setpoint) -> None:
        """See `HostLink`."""
        self._twin.setpoints[self._name].send(self._twin.now, setpoint)

    def told(self) -> dict[str, Told]:
        """See `HostLink`. The laws share a computer, and hear what was said before this tick."""
        heard = {}
        for name, (said_at, newest, before) in self._twin.blackboard.items():
            told = newest if said_at < self._twin.now else before
            if name != self._name and told is not None:
                heard[name] = told
        return heard

    def tell(self, told: Told) -> None:
        """See `HostLink`."""
        board, now = self._twin.blackboard, self._twin.now
        _, newest, _ = board.get(self._name, (now, None, None))
        board[self._name] = (now, told, newest)
