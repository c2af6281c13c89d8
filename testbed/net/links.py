"""`VehicleLink` and `HostLink` over Zenoh."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar

import zenoh
from msgspec import Struct

from testbed.core.lab import Lab
from testbed.core.types import LawMessage, Setpoint, State
from testbed.net.envelope import Inbox, Outbox
from testbed.net.impairment import NetworkImpairment, calm
from testbed.net.keys import Keys
from testbed.net.payload import open_message, open_setpoint, open_state
from testbed.net.session import Publisher, Subscriber
from testbed.realtime.wall_clock import WallClock

M = TypeVar("M")

KEPT_S = 10.0  # lifetime of a state [s]


class Party(Struct, frozen=True):
    """One end of the network in a run: its name, session and lab."""

    session: zenoh.Session
    lab: Lab
    run: int  # number of the session
    clock: WallClock
    seed: int
    name: str  # of the party: a vehicle, or "host"
    worse: Callable[[], tuple[float, float]] = calm  # see `NetworkImpairment`

    @property
    def keys(self) -> Keys:
        """Network keys of the lab."""
        return Keys(self.lab.network.lab)


class NewestMessage(Generic[M]):
    """Receives a key and keeps its newest message."""

    def __init__(self, party: Party, key: str, open_body: Callable[[Any], M]) -> None:
        impairment = NetworkImpairment(
            party.lab.impairment, party.seed, f"{key} to {party.name}", party.worse
        )
        self._subscriber = Subscriber(party.session, key, impairment.arrival)
        self._clock = party.clock
        self.inbox: Inbox[M] = Inbox(open_body, party.run, party.lab.late_s)

    @property
    def arrived(self) -> int:
        """Number of messages so far, of any kind."""
        return self._subscriber.arrived

    def newest(self) -> M | None:
        """The newest message, of any age."""
        for at, data in self._subscriber.received():
            self.inbox.take(data, self._clock.of(at))
        return self.inbox.newest


def _newest(inputs: Mapping[str, NewestMessage[M]]) -> dict[str, M]:
    found = {name: one.newest() for name, one in inputs.items()}
    return {name: message for name, message in found.items() if message is not None}


class MessageSender:
    """Sends messages on a key."""

    def __init__(self, party: Party, key: str) -> None:
        self._publisher, self._clock = Publisher(party.session, key), party.clock
        self.outbox = Outbox(party.run)

    def send(self, message: object, valid_until: float | None = None) -> None:
        """Send a message; without `valid_until` [s] it expires after `KEPT_S`."""
        now = self._clock.now
        until = now + KEPT_S if valid_until is None else valid_until
        self._publisher.send(self.outbox.seal(message, now, until))


class ZenohVehicleLink:
    """See `VehicleLink`. `others` are the vehicles whose states and messages are received."""

    def __init__(self, party: Party, others: Iterable[str]) -> None:
        keys, name = party.keys, party.name
        self.setpoints = NewestMessage(party, keys.of(name, "setpoint"), open_setpoint)
        others = [other for other in others if other != name]
        self._states = {n: NewestMessage(party, keys.of(n, "state"), open_state) for n in others}
        self._messages = {
            n: NewestMessage(party, keys.of(n, "message"), open_message) for n in others
        }
        self._state, self._message = (
            MessageSender(party, keys.of(name, what)) for what in ("state", "message")
        )

    @property
    def foreign(self) -> int:
        """Number of messages of another session so far."""
        inputs: list[NewestMessage[Any]] = [
            self.setpoints,
            *self._states.values(),
            *self._messages.values(),
        ]
        return sum(one.inbox.foreign for one in inputs)

    @property
    def arrived(self) -> dict[str, int]:
        """Number of messages so far, by what they carry."""
        counts = {"setpoints": self.setpoints.arrived}
        counts |= {f"states of {n}": one.arrived for n, one in self._states.items()}
        return counts | {f"messages of {n}": one.arrived for n, one in self._messages.items()}

    def setpoint(self) -> Setpoint | None:
        """See `VehicleLink`."""
        return self.setpoints.newest()

    def neighbours(self) -> dict[str, State]:
        """See `VehicleLink`."""
        return _newest(self._states)

    def publish(self, state: State) -> None:
        """See `VehicleLink`."""
        self._state.send(state)

    def messages(self) -> dict[str, LawMessage]:
        """See `VehicleLink`."""
        return _newest(self._messages)

    def broadcast(self, message: LawMessage) -> None:
        """See `VehicleLink`."""
        self._message.send(message)


class LocalMessages:
    """Messages between laws on the same computer: readable from the next tick on."""

    def __init__(self) -> None:
        self._messages: dict[str, tuple[int, LawMessage, LawMessage | None]] = {}
        self.tick = 0

    def write(self, name: str, message: LawMessage) -> None:
        """Store a vehicle's message for the others."""
        _, newest, _ = self._messages.get(name, (0, None, None))
        self._messages[name] = (self.tick, message, newest)

    def read(self, name: str) -> dict[str, LawMessage]:
        """Messages that the others wrote before this tick."""
        received = {}
        for other, (tick, newest, before) in self._messages.items():
            message = newest if tick < self.tick else before
            if other != name and message is not None:
                received[other] = message
        return received


class ZenohHostLink:
    """See `HostLink`. The links of all vehicles share one `states`."""

    def __init__(
        self,
        party: Party,
        vehicle: str,
        states: Mapping[str, NewestMessage[State]],
        board: LocalMessages,
    ) -> None:
        self._name, self._states, self._board = vehicle, states, board
        self.setpoints = MessageSender(party, party.keys.of(vehicle, "setpoint"))

    def own(self) -> State | None:
        """See `HostLink`."""
        return self._states[self._name].newest()

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        found = _newest(self._states)
        found.pop(self._name, None)
        return found

    def publish(self, setpoint: Setpoint) -> None:
        """See `HostLink`."""
        self.setpoints.send(setpoint, setpoint.valid_until)

    def messages(self) -> dict[str, LawMessage]:
        """See `HostLink`."""
        return self._board.read(self._name)

    def broadcast(self, message: LawMessage) -> None:
        """See `HostLink`."""
        self._board.write(self._name, message)


def host_states(party: Party, vehicles: Iterable[str]) -> dict[str, NewestMessage[State]]:
    """Receivers of each vehicle's state, for the host."""
    return {n: NewestMessage(party, party.keys.of(n, "state"), open_state) for n in vehicles}
