"""The door of a flight: where an operator's page on the host's machine asks for changes in flight.

A socket in the folder of the flight's note, for the same user only. The flight looks at it between
two ticks and waits for nothing; who knocks waits for the answer. Only `testbed run --console` opens
a door, so no other flight can be changed.
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

LARGEST = 8192  # a message [bytes]
MANY = 64  # messages read between two ticks

Mode = Literal["law", "velocity", "force"]
Share = float  # -1 to 1; more is cut


class Look(Struct, frozen=True, tag=True):
    """Report the state."""


class Tune(Struct, frozen=True, tag=True):
    """Change parameters of the law."""

    values: dict[str, float]


class Revert(Struct, frozen=True, tag=True):
    """Give all parameters of the law the values of the start."""


class Steer(Struct, frozen=True, tag=True):
    """Fly a vehicle by hand, or by its law."""

    vehicle: str
    mode: Mode
    by: str  # the page; another one cannot take a vehicle that is being flown
    stamp_ns: int = 0  # newest time that the page knows, on this machine's monotonic clock
    x: Share = 0.0  # in W
    y: Share = 0.0
    turn: Share = 0.0


Wish = Look | Tune | Revert | Steer


class Controls(Struct, frozen=True):
    """What an operator can change now."""

    gains: dict[str, float]  # the law's parameters
    start: dict[str, float]  # at the start of the flight
    modes: dict[str, Mode]  # how each vehicle is flown
    by: dict[str, str]  # pages that fly vehicles by hand
    no_hands: str = ""  # why there is no flying by hand; empty: there is


class Told(Struct, frozen=True):
    """The answer to a wish."""

    ok: bool
    words: str
    controls: Controls
    number: int = 0  # of the wish


class Letter(Struct, frozen=True):
    """A wish on its way."""

    wish: Wish
    number: int = 0


class Wishes(Protocol):
    """Where wishes come from."""

    def heard(self) -> Iterator[tuple[Wish, Callable[[Told], None]]]:
        """Wishes since the last call, and how to answer each."""
        ...


class Door:
    """The flight's end; a context manager.

    Args:
        path: of the socket.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._decode = msgspec.json.Decoder(Letter).decode
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        path.unlink(missing_ok=True)  # of an earlier process with this number
        with short(path) as name:
            self._socket.bind(name)
        path.chmod(0o600)

    def heard(self) -> Iterator[tuple[Wish, Callable[[Told], None]]]:
        """See `Wishes`."""
        for _ in range(MANY):
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except OSError:
                return
            with suppress(msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                letter = self._decode(data)
                yield letter.wish, partial(self._answer, sender, letter.number)

    def _answer(self, sender: bytes | None, number: int, told: Told) -> None:
        if sender:
            with suppress(OSError):
                answer = msgspec.structs.replace(told, number=number)
                self._socket.sendto(msgspec.json.encode(answer), sender)

    def __enter__(self) -> "Door":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, wish: Wish, wait_s: float) -> Told | None:
    """Knock, and wait for the answer; None: the flight does not answer."""
    number, end = secrets.randbits(48), monotonic() + wait_s
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as knock:
        knock.bind("")  # a name of its own, for the answer
        knock.settimeout(wait_s)
        try:
            _send(knock, path, Letter(wish, number))
            while (left := end - monotonic()) > 0.0:
                knock.settimeout(left)
                told = msgspec.json.decode(knock.recv(1 << 16), type=Told)
                if told.number == number:
                    return told
        except (OSError, msgspec.MsgspecError):
            return None
    return None


def tell(path: Path, wish: Wish) -> bool:
    """Knock without waiting; whether the flight takes messages."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as knock:
        knock.setblocking(False)
        try:
            _send(knock, path, Letter(wish))
        except OSError:
            return False
    return True


def _send(knock: socket.socket, path: Path, letter: Letter) -> None:
    with short(path) as name:
        knock.sendto(msgspec.json.encode(letter), name)


@contextmanager
def short(path: Path) -> Iterator[str]:
    """A name of a socket that the kernel takes: a path may have 107 characters only."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
