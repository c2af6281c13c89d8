"""Cameras that send a JSON datagram for each exposure.

    {"frame": 7, "age": 0.004, "bodies": {"sat1": [x, y, z, qx, qy, qz, qw], "sat2": null}}

`frame` counts exposures, `age` is from the middle of the exposure to sending it [s], positions are
in m in the axes of the cameras, and a body that is not tracked is null or left out.

    [lab.mocap]
    system = "udp_json"
    interface = "0.0.0.0"
    options = { port = 9870 }
"""

import math
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from testbed.core.lab import MocapWire, Port
from testbed.mocap.datagram import receive, stamped
from testbed.mocap.exposure import Exposure, Sighting

MOST = 512  # datagrams in one poll: a flood must not keep the vehicle from flying
MOST_BODIES = 256
OVERTAKEN = 100  # frames; a number farther back is of cameras that were started again
Numbers = tuple[float, float, float, float, float, float, float]


class Frame(Struct, frozen=True):
    """A datagram."""

    frame: Annotated[int, Meta(ge=0, lt=2**53)]
    bodies: dict[str, Numbers | None]
    age: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0  # [s]


DECODER = msgspec.json.Decoder(Frame)


class UdpJsonCameras:
    """A `MocapSource`."""

    def __init__(self, wire: MocapWire, port: Port = 9870) -> None:
        self._socket = stamped(wire.interface, port)
        self._delay_s = wire.delay_s  # what `age` leaves out
        self._known: set[str] = set()
        self._newest = Exposure(-1, 0, 0, {})
        self.bad = 0  # datagrams that were no frame

    def poll(self) -> list[Exposure]:
        """See `MocapSource`."""
        exposures: list[Exposure] = []
        for _ in range(MOST):
            if (got := receive(self._socket)) is None:
                break
            data, arrived_ns, _ = got
            try:
                frame = DECODER.decode(data)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                self.bad += 1
                continue
            if 0 <= self._newest.number - frame.frame < OVERTAKEN:
                continue  # overtaken, or said twice
            if len(self._known | frame.bodies.keys()) > MOST_BODIES:
                self.bad += 1
                continue
            self._newest = self._exposure(frame, arrived_ns)
            exposures.append(self._newest)
        return exposures

    def _exposure(self, frame: Frame, arrived_ns: int) -> Exposure:
        self._known |= frame.bodies.keys()
        arrived = max(arrived_ns, self._newest.arrived_ns)  # stamps are read to some microseconds
        exposed = arrived - round(1e9 * (frame.age + self._delay_s))
        seen = {name: _sighting(frame.bodies.get(name)) for name in self._known}
        return Exposure(frame.frame, max(exposed, self._newest.exposed_ns), arrived, seen)

    def close(self) -> None:
        """See `MocapSource`."""
        self._socket.close()


def _sighting(numbers: Numbers | None) -> Sighting:
    if numbers is None or not all(map(math.isfinite, numbers)):
        return Sighting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), tracked=False)
    return Sighting(numbers[:3], numbers[3:], tracked=True)
