"""Requests from an operator's page to a flight on the same machine, and the flight's replies.

They pass through a Unix socket in the folder of the flight's note, which only the same user can
open. The flight reads it between two ticks and never waits; the page waits for the reply. Only
`testbed run --console` creates the socket, so no other flight can be changed.
"""

import os
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Literal, Protocol

import msgspec
from msgspec import Struct

LARGEST = 8192  # longest request [bytes]
MANY = 64  # requests read between two ticks

Mode = Literal["law", "velocity", "force"]
Share = float  # -1 to 1; more is cut


class ReadControls(Struct, frozen=True, tag=True):
    """Reply with the controls as they are now."""


class Tune(Struct, frozen=True, tag=True):
    """Change parameters of the law."""

    values: dict[str, float]


class Revert(Struct, frozen=True, tag=True):
    """Reset all parameters of the law to their values at the start."""


class Steer(Struct, frozen=True, tag=True):
    """Fly a vehicle by hand, or by its law."""

    vehicle: str
    mode: Mode
    by: str  # the page; another one cannot take a vehicle that is being flown
    stamp_ns: int = 0  # newest time that the page knows, on this machine's monotonic clock
    x: Share = 0.0  # in W
    y: Share = 0.0
    turn: Share = 0.0


OperatorRequest = ReadControls | Tune | Revert | Steer


class Controls(Struct, frozen=True):
    """What an operator can change now."""

    gains: dict[str, float]  # the law's parameters
    start: dict[str, float]  # at the start of the flight
    modes: dict[str, Mode]  # how each vehicle is flown
    by: dict[str, str]  # pages that fly vehicles by hand
    why_no_manual: str = ""  # why no vehicle can be flown by hand; empty: it can


class Reply(Struct, frozen=True):
    """The reply to a request."""

    ok: bool
    words: str
    controls: Controls
    number: int = 0  # of the request


class RequestMessage(Struct, frozen=True):
    """A request on the socket; its number matches the reply."""

    request: OperatorRequest
    number: int = 0


class RequestSource(Protocol):
    """Where requests come from."""

    def received(self) -> Iterator[tuple[OperatorRequest, Callable[[Reply], None]]]:
        """Requests since the last call, each with the function that replies to it."""
        ...


class RequestServer:
    """The flight's end of the socket; a context manager.

    Args:
        path: of the socket.

    Raises:
        OSError: the socket cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._decode = msgspec.json.Decoder(RequestMessage).decode
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        path.unlink(missing_ok=True)  # of an earlier process with this number
        with short_path(path) as name:
            self._socket.bind(name)
        path.chmod(0o600)

    def received(self) -> Iterator[tuple[OperatorRequest, Callable[[Reply], None]]]:
        """See `RequestSource`."""
        for _ in range(MANY):
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except OSError:
                return
            with suppress(msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                message = self._decode(data)
                yield message.request, partial(self._reply, sender, message.number)

    def _reply(self, sender: bytes | None, number: int, reply: Reply) -> None:
        if sender:
            with suppress(OSError):
                numbered = msgspec.structs.replace(reply, number=number)
                self._socket.sendto(msgspec.json.encode(numbered), sender)

    def __enter__(self) -> "RequestServer":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, request: OperatorRequest, wait_s: float) -> Reply | None:
    """Send a request and wait for the reply; None: the flight does not reply."""
    number, end = secrets.randbits(48), monotonic() + wait_s
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.bind("")  # a name that the kernel picks, for the reply
        client.settimeout(wait_s)
        try:
            _send(client, path, RequestMessage(request, number))
            while (left := end - monotonic()) > 0.0:
                client.settimeout(left)
                reply = msgspec.json.decode(client.recv(1 << 16), type=Reply)
                if reply.number == number:
                    return reply
        except (OSError, msgspec.MsgspecError):
            return None
    return None


def send(path: Path, request: OperatorRequest) -> bool:
    """Send a request that needs no reply; False: the flight does not receive."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.setblocking(False)
        try:
            _send(client, path, RequestMessage(request))
        except OSError:
            return False
    return True


def _send(client: socket.socket, path: Path, message: RequestMessage) -> None:
    with short_path(path) as name:
        client.sendto(msgspec.json.encode(message), name)


@contextmanager
def short_path(path: Path) -> Iterator[str]:
    """A short path of the same socket: the kernel takes at most 107 characters."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
