"""The page's STOP: stops the run by every way that leads to it.

A flight on the twin gets the signal of `testbed stop`. On wires the stop is sent through the host,
as `testbed stop` does, and over a second line that does not need the host: this process listens at
a port of its own, tells the vehicles (key `operator/line`), and they connect to it. So a host that
hangs or is suspended does not keep a stop from its vehicles.

All of this is prepared before the button is pressed; a press sends, and then asks who has heard it.
"""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any, NamedTuple

import zenoh

from testbed.net.access import control, read_access
from testbed.net.credentials import BadgeError
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, answers, dial, listen
from testbed.net.stop import ANSWER_S, Flight, end_twin, known_flights, runs

LOOK_S = 0.5  # between two looks at the connections
OPEN_S = 1.0  # time for a host's handshake
ASK_S = 0.2
PRIORITY = 90  # of a press, above hosts and vehicles


class Ways(NamedTuple):
    """How the flight can be stopped now."""

    words: str
    ready: bool  # by at least one way


NONE = Ways("not connected: no flight of this run is known on this machine", ready=False)


class Stopper:
    """Keeps the connections to one run's flight.

    Args:
        run: its folder.
    """

    def __init__(self, run: Path) -> None:
        self._run, self._lock = str(run.absolute()), Lock()
        self._note: tuple[Path, Flight] | None = None
        self._host: zenoh.Session | None = None
        self._line: zenoh.Session | None = None
        self._port = 0
        self._on_line: set[str] = set()  # vehicles that are connected to the second line
        self.ways = NONE
        self._answered: dict[str, list[str]] = {}  # by press

    # Connections

    def keep(self, left: Event) -> None:
        """Find the flight and keep its connections, until `left` is set."""
        while not left.is_set():
            found = next((one for one in known_flights() if one[1].folder == self._run), None)
            if found is None or not runs(found[1]):
                found = None
            self._note = found
            if found is None:
                self._hang_up()
                self.ways = NONE
            elif found[1].endpoint:
                self.ways = self._connect(found[1])
            else:
                self.ways = Ways("the twin's process takes signals", ready=True)
            left.wait(LOOK_S)
        self._hang_up()

    def _connect(self, flight: Flight) -> Ways:
        folder = Path(flight.keys) if flight.keys else None
        keys = Keys(flight.lab)
        if self._host is None:
            with suppress(NetworkError):
                self._host = dial(flight.endpoint, 0.0, folder, OPEN_S)
        if self._line is None:
            self._line = self._open_line(flight, folder)
        host = self._host is not None and bool(list(self._host.info.routers_zid()))
        if self._line is not None:
            if self._host is not None and host:
                self._host.put(keys.line, str(self._port).encode())
            tokens = self._line.liveliness().get(keys.of("*", "alive"), timeout=ASK_S)
            found = [str(one.ok.key_expr) for one in tokens if one.ok is not None]
            self._on_line = {key.split("/")[-2] for key in found}
        there = len(self._on_line & set(flight.vehicles))
        words = "the host answers" if host else "the host does not answer"
        words += f"; second line to {there} of {len(flight.vehicles)} vehicles"
        return Ways(words, host or there > 0)

    def _open_line(self, flight: Flight, folder: Path | None) -> zenoh.Session | None:
        """Listen for the vehicles, on the host's address."""
        protocol, _, rest = flight.endpoint.partition("/")
        address = rest.rpartition(":")[0]
        try:
            self._port = _free_port(address.strip("[]"))
            rules = control(read_access(folder), Keys(flight.lab)) if folder is not None else None
            return listen(f"{protocol}/{address}:{self._port}", folder, rules)
        except (NetworkError, BadgeError, OSError):
            return None  # the way through the host remains

    def _hang_up(self) -> None:
        for session in (self._host, self._line):
            if session is not None:
                with suppress(zenoh.ZError):
                    session.close()
        self._host, self._line, self._on_line = None, None, set()

    # A press

    def press(self, number: str) -> dict[str, Any]:
        """Stop; a repeated `number` is the same press and sends nothing."""
        with self._lock:
            if number in self._answered:
                return {"lines": self._answered[number], "sent": True}
        note = self._note
        if note is None:
            return {"lines": [self.ways.words], "sent": False}
        with ahead():
            lines, sent = self._twin(*note) if not note[1].endpoint else self._wires(note[1])
        with self._lock:
            self._answered[number] = lines
        return {"lines": lines, "sent": sent}

    def _twin(self, note: Path, flight: Flight) -> tuple[list[str], bool]:
        try:
            end_twin(note, flight)
        except OSError as error:
            return [f"{flight.name}: not asked: {error}"], False
        return [f"{flight.name} on the twin: stops"], True

    def _wires(self, flight: Flight) -> tuple[list[str], bool]:
        keys, heard = Keys(flight.lab), set[str]()
        sessions = [one for one in (self._line, self._host) if one is not None]
        for session in sessions:
            with suppress(zenoh.ZError):
                session.put(keys.stop, b"stop")

        def ask(session: zenoh.Session) -> None:
            with suppress(zenoh.ZError):
                said = answers(session, keys.stop, ANSWER_S)
                heard.update(one.decode(errors="replace") for one in said)

        askers = [Thread(target=ask, args=(one,), daemon=True) for one in sessions]
        for asker in askers:
            asker.start()
        for asker in askers:
            asker.join(ANSWER_S)
            if heard >= set(flight.vehicles):
                break
        names = sorted({*flight.vehicles, *heard})
        return [f"{n}: {'stops' if n in heard else 'did not answer'}" for n in names], bool(heard)


def _free_port(address: str) -> int:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family) as one:
        one.bind((address, 0))
        return int(one.getsockname()[1])


@contextmanager
def ahead() -> Iterator[None]:
    """Run this thread before the flights of this machine, where the system allows it."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
