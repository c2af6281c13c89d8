"""Injected messages of a program that does not belong to the session."""

from testbed.core.types import Accel, Pose, Reference, Trajectory, Twist
from testbed.net.envelope import Outbox
from testbed.net.links import Party
from testbed.net.session import Publisher


class Intruder:
    """Sends to the vehicles' setpoint keys.

    Args:
        party: the host's end of the network; its session is imitated with another id.
    """

    def __init__(self, party: Party) -> None:
        self._party = party
        self._outbox = Outbox(party.run ^ 1)
        self._publishers: dict[str, Publisher] = {}  # kept: messages of a closed one are lost

    def intrude(self, name: str) -> None:
        """Send a setpoint as a leftover host of another session would."""
        now = self._party.clock.now
        there = Reference(now, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0))
        setpoint = Trajectory((there,), now + 1.0)
        self._publisher(name).send(self._outbox.seal(setpoint, now, now + 1.0))

    def flood(self, name: str, count: int) -> None:
        """Send messages without meaning, as a runaway program would."""
        for _ in range(count):
            self._publisher(name).send(b"nothing")

    def _publisher(self, name: str) -> Publisher:
        if name not in self._publishers:
            key = self._party.keys.of(name, "setpoint")
            self._publishers[name] = Publisher(self._party.session, key)
        return self._publishers[name]
