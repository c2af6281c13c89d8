"""A NatNet server: the twin's camera interface for clients that were written for OptiTrack.

It answers CONNECT, model definitions, echoes and keep-alives, and sends frames by multicast or to
each client. Two kinds of unicast client exist: those that send keep-alives expect frames on
the socket they ask from, the others on the data port of their machine.
"""

import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

from testbed.mocap.datagram import LARGEST
from testbed.mocap.natnet import (
    Described,
    MocapFrame,
    NatNetError,
    Packet,
    ServerInfo,
    Version,
    encode_echo,
    encode_frame,
    encode_models,
    encode_server_info,
    packet,
    unpack,
)
from testbed.realtime.wall_clock import monotonic_ns

FORGET_NS = 30_000_000_000  # a client whose keep-alives stop is dropped after this time


class NatNetAddress(NamedTuple):
    """Addresses of a server."""

    host: str
    command_port: int
    data_port: int
    group: str | None = None


class NatNetServer:
    """A server whose clock is this machine's monotonic clock, in nanoseconds.

    Raises:
        OSError: the port is taken.
    """

    def __init__(
        self, address: NatNetAddress, version: Version, bodies: Sequence[Described]
    ) -> None:
        self._address, self._version, self._bodies = address, version, bodies
        self._alive: dict[tuple[str, int], int] = {}  # time of each client's last keep-alive
        self._silent: set[str] = set()  # machines that asked without keep-alives
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind((address.host, address.command_port))
        except OSError as error:
            self.socket.close()
            raise OSError(
                f"cameras cannot be served at {address.host}, port {address.command_port}:"
                f" {error.strerror}; expected an address of this machine and a free port,"
                " see `server` and `command_port` of [lab.mocap]: is another twin running?"
            ) from None
        self.socket.setblocking(False)
        if address.group:
            to = self.socket
            to.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address.host))
            to.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            to.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)

    def __enter__(self) -> "NatNetServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    @property
    def command_port(self) -> int:
        """Port on which it receives commands."""
        return int(self.socket.getsockname()[1])

    def serve(self) -> None:
        """Answer the requests that have arrived; does not wait."""
        while True:
            try:
                data, client = self.socket.recvfrom(LARGEST)
            except BlockingIOError:
                return
            except ConnectionRefusedError:  # the client has gone
                continue
            try:
                kind, payload = unpack(data)
            except NatNetError:
                continue
            answer = self._answer(kind, bytes(payload), client)
            if answer:
                self._send(answer, client)

    def _answer(self, kind: int, payload: bytes, client: tuple[str, int]) -> bytes | None:
        match kind:
            case Packet.CONNECT:
                self._silent.add(client[0])
                a = self._address
                return encode_server_info(
                    ServerInfo("airbearing-testbed", self._version, 10**9, a.data_port, a.group)
                )
            case Packet.REQUEST_MODEL_DEF:
                return encode_models(self._bodies, self._version)
            case Packet.KEEP_ALIVE:
                self._alive[client] = monotonic_ns()
                return None
            case Packet.ECHO_REQUEST if len(payload) >= 8:
                return encode_echo(int.from_bytes(payload[:8], "little"), monotonic_ns())
            case Packet.REQUEST:
                return packet(Packet.RESPONSE, bytes(4))
            case _:
                return packet(Packet.UNRECOGNIZED)

    def send(self, frame: MocapFrame) -> None:
        """Send a frame to all clients."""
        self.send_packet(encode_frame(frame, self._version))

    def send_packet(self, data: bytes) -> None:
        """Send an encoded frame to all clients."""
        a = self._address
        if a.group:
            self._send(data, (a.group, a.data_port))
            return
        now = monotonic_ns()
        self._alive = {c: t for c, t in self._alive.items() if now - t < FORGET_NS}
        for client in self._alive:
            self._send(data, client)
        for host in self._silent - {host for host, _ in self._alive}:
            self._send(data, (host, a.data_port))

    def _send(self, data: bytes, client: tuple[str, int]) -> None:
        with suppress(BlockingIOError, ConnectionRefusedError):  # like a lost datagram
            self.socket.sendto(data, client)
