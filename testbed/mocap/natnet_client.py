"""A NatNet client that never blocks: `poll` returns the exposures that have arrived.

The kernel stamps arrivals, so the time of polling does not matter. The server's clock is read with
echoes once a second; without answers it is estimated from the fastest frame. Datagrams from other
addresses than the server's are ignored, because all NatNet servers use the same default group.
"""

import ipaddress
import socket
from contextlib import suppress

from testbed.core.lab import MocapWire
from testbed.mocap.datagram import receive, stamped
from testbed.mocap.exposure import Exposure, Sighting
from testbed.mocap.natnet import (
    MocapFrame,
    NatNetError,
    Packet,
    ServerInfo,
    decode_echo,
    decode_frame,
    decode_models,
    decode_server_info,
    packet,
    unpack,
)
from testbed.realtime.clock_sync import ClockOffset
from testbed.realtime.wall_clock import monotonic_ns

ASK_NS = 1_000_000_000  # between two queries to the server
FIRST_ASK_NS = 100_000_000  # the same before its first answer
MOST = 512  # datagrams per poll: two seconds of frames; a flood must not block the vehicle
OLDEST = (3, 0)  # oldest supported version of NatNet
ANYBODY = "0.0.0.0"  # server address that means this machine
MOST_SENDERS = 16  # foreign senders counted separately
MOST_NAMELESS = 1000  # bodies without a name that are remembered


_FRAME = int(Packet.FRAME)


class NatNetClient:
    """A `MocapSource`.

    Raises:
        OSError: the address is not one of this machine, or the port is taken.
    """

    def __init__(self, wire: MocapWire) -> None:
        host = _address_of(wire.server)  # once, because looking up a name blocks
        self._server = (host, wire.command_port)
        self._interface = wire.interface
        self._only = None if host == ANYBODY else host
        try:
            self._sockets = [stamped(wire.interface, 0)]
        except OSError as error:
            raise OSError(
                f"[lab.mocap] interface = {wire.interface!r}: {error.strerror}; expected an address"
                " of this machine towards the cameras (`ip -brief address` shows them)"
            ) from None
        if wire.group:
            try:
                self._sockets.append(_joined(wire.group, wire.data_port, wire.interface))
            except OSError:
                self.close()
                raise
        self._ask_due, self._asked = 0, 0
        self.info: ServerInfo | None = None
        self.names: dict[int, str] = {}
        self._strange: set[int] = set()  # bodies in frames without a description
        self._nameless: set[int] = set()  # those also missing in the newest description
        self.clock = ClockOffset()
        self.bad = 0  # invalid datagrams
        self.too_old: tuple[int, int] | None = None  # unsupported version of the server
        self.foreign: dict[str, int] = {}  # datagrams from other senders, by address
        self.newest: MocapFrame | None = None

    @property
    def complaint(self) -> str:
        """Likely reason for missing poses, from the datagrams; empty: not known."""
        if self.too_old is not None:
            version = ".".join(map(str, self.too_old))
            return f"the server speaks NatNet {version}; 3.0 to 4.1 are supported"
        if self.foreign:
            others = ", ".join(f"{n} from {sender}" for sender, n in self.foreign.items())
            return f"datagrams from other senders than the server: {others}"
        away = not ipaddress.ip_address(self._server[0]).is_loopback and self._only is not None
        if self.info is None and away and ipaddress.ip_address(self._interface).is_loopback:
            return f"none: {self._interface} has no route to {self._server[0]}; 0.0.0.0 has"
        if self.info is not None and not self.names:
            return "the server answers, but it has no rigid bodies"
        return ""

    def fileno(self) -> int:
        """File descriptor of the socket that receives frames."""
        return self._sockets[-1].fileno()

    def close(self) -> None:
        """See `MocapSource`."""
        for one in self._sockets:
            one.close()

    def poll(self) -> list[Exposure]:
        """See `MocapSource`."""
        exposures: list[Exposure] = []
        for one in self._sockets:
            for _ in range(MOST):
                if (got := receive(one)) is None:
                    break
                data, arrived_ns, sender = got
                if self._only is not None and sender != self._only:
                    if sender in self.foreign or len(self.foreign) < MOST_SENDERS:
                        self.foreign[sender] = self.foreign.get(sender, 0) + 1
                    continue
                try:
                    exposure = self._take(data, arrived_ns)
                except NatNetError:
                    self.bad += 1
                    continue
                if exposure is not None:
                    exposures.append(exposure)
        self._ask()
        return exposures

    def _ask(self) -> None:
        now = monotonic_ns()
        if now < self._ask_due:
            return
        known = self.info is not None and self.names
        self._ask_due, self._asked = now + (ASK_NS if known else FIRST_ASK_NS), now
        questions = [packet(Packet.ECHO_REQUEST, now.to_bytes(8, "little"))]
        if self.info is None:
            questions = [packet(Packet.CONNECT)]
        elif not self.names or self._strange:
            questions.append(packet(Packet.REQUEST_MODEL_DEF))
        if self.info is not None and self.info.group is None:
            questions.append(packet(Packet.KEEP_ALIVE))
        for question in questions:
            with suppress(OSError):  # no network: missing poses are detected elsewhere
                self._sockets[0].sendto(question, self._server)

    def _take(self, data: bytes, arrived_ns: int) -> Exposure | None:
        kind, payload = unpack(data)
        if kind == _FRAME:
            if self.info is None or not self.names:
                return None
            return self._expose(decode_frame(payload, self.info.version), arrived_ns)
        match kind:
            case Packet.SERVER_INFO:
                info = decode_server_info(payload)
                self.too_old = info.version if info.version < OLDEST else None
                if self.too_old is not None:
                    raise NatNetError("a server of an unsupported version")
                self.info, self._ask_due = info, 0
            case Packet.MODEL_DEF if self.info:
                models = decode_models(payload, self.info.version)
                self.names = {model.id: model.name for model in models}
                if len(self._nameless) > MOST_NAMELESS:
                    self._nameless = set()
                self._nameless = (self._nameless | self._strange) - self.names.keys()
                self._strange = set()
            case Packet.ECHO_RESPONSE if self.info:
                asked, server = decode_echo(payload)
                if asked != self._asked:
                    raise NatNetError("an echo that was not requested")
                self.clock.exchanged(asked, self._ns(server), arrived_ns)
        return None

    def _ns(self, ticks: int) -> float:
        assert self.info is not None
        return ticks * (1e9 / self.info.clock_hz) if self.info.clock_hz != 10**9 else ticks

    def _expose(self, frame: MocapFrame, arrived_ns: int) -> Exposure | None:
        self.newest = frame
        strange = {body.id for body in frame.bodies if body.id not in self.names}
        if strange:
            self._strange = strange  # asked for once a second: it may get a name later
            if not strange <= self._nameless:
                self._ask_due, self.names = 0, {}  # the operator changed the bodies: ask again
                return None
        self.clock.received(self._ns(frame.sent), arrived_ns)
        exposed = self.clock.to_own(self._ns(frame.exposed))
        assert exposed is not None
        bodies = {
            self.names[b.id]: Sighting(b.position, b.rotation, b.tracked)
            for b in frame.bodies
            if b.id not in strange
        }
        return Exposure(frame.number, exposed, arrived_ns, bodies)


def _address_of(server: str) -> str:
    try:
        return str(socket.getaddrinfo(server, None, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0])
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not a host name"
        raise OSError(
            f"[lab.mocap] server = {server!r}: {why}; expected the name or the IPv4 address of the"
            " machine that runs the motion-capture software"
        ) from None


def _joined(group: str, port: int, interface: str) -> socket.socket:
    """A socket that receives a multicast group."""
    try:
        data = stamped(group, port, shared=True)
        try:
            membership = socket.inet_aton(group) + socket.inet_aton(interface)
            data.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError:
            data.close()
            raise
    except OSError as error:
        raise OSError(
            f"[lab.mocap] group = {group!r} at port {port}, by {interface}: {error}; expected the"
            " multicast address of the motion-capture software, such as 239.255.42.99, and the"
            " address of this machine towards it"
        ) from None
    return data
