"""Poses from a Zenoh topic, for a lab that publishes its poses over Zenoh.

The message is MessagePack: [number, exposed, sent, {name: [x, y, z, qx, qy, qz, qw]}]; times are
in ns of the sender's monotonic clock, and a body that is not tracked is omitted. The sender's clock
is estimated from the fastest message.
"""

import msgspec
import zenoh

from testbed.mocap.exposure import Exposure, Sighting
from testbed.net.session import Subscriber
from testbed.realtime.clock_sync import ClockOffset

MOST_BODIES = 256

Bodies = dict[str, tuple[float, float, float, float, float, float, float]]


def encode_poses(number: int, exposed_ns: int, sent_ns: int, bodies: Bodies) -> bytes:
    """Encode an exposure as the message on the pose topic."""
    return msgspec.msgpack.encode((number, exposed_ns, sent_ns, bodies))


class PoseTopic:
    """Receives exposures from the pose topic."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._subscriber, self.clock, self.bad = Subscriber(session, key), ClockOffset(), 0
        self._decode = msgspec.msgpack.Decoder(tuple[int, int, int, Bodies]).decode
        self._known: set[str] = set()

    def poll(self) -> list[Exposure]:
        """See `MocapSource`."""
        exposures = []
        for arrived, data in self._subscriber.received():
            try:
                number, exposed, sent, bodies = self._decode(data)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                self.bad += 1
                continue
            if len(self._known | bodies.keys()) > MOST_BODIES:
                self.bad += 1
                continue
            self.clock.received(sent, arrived)
            at = self.clock.to_own(exposed)
            assert at is not None
            self._known |= bodies.keys()
            seen = {name: Sighting(b[:3], b[3:], tracked=True) for name, b in bodies.items()}
            lost = {
                name: Sighting((0.0,) * 3, (0.0, 0.0, 0.0, 1.0), tracked=False)
                for name in self._known - bodies.keys()
            }
            exposures.append(Exposure(number, at, arrived, seen | lost))
        return exposures

    def close(self) -> None:
        """See `MocapSource`."""
