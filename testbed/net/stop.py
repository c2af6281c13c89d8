"""`testbed stop`: stop every flight, from any machine, without any arguments.

It needs no experiment and imports no slow modules such as numpy. Flights on this machine are found
by their notes (`flight_note.py`); the default endpoint is also tried without a note. On another
machine the operator's key folder has the host's endpoint; it is in one fixed place, so that nothing
has to be typed in a hurry.

Flights and vehicles that did not answer are listed; the exit code is 0 only if all answered.
"""

import json
import os
import secrets
import signal
import socket
import sys
import threading
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

from testbed.net.flight_note import (
    StoppableFlight,
    complain,
    heard_stop,
    known_flights,
    remove,
    runs,
)

if TYPE_CHECKING:
    import zenoh

    from testbed.net.keys import Keys

OK, FAILED = 0, 1
WAIT_S = 0.0  # time for a host to start listening
OPEN_S = 1.0  # time for a host's handshake
ANSWER_S = 0.5  # time for vehicles to answer
DIRECT_S = 0.3  # time for vehicles to answer without their host
LATE_S = 2.0  # further time for vehicles that have not answered: busy computers answer late
END_S = 4.0  # time for a flight on the twin, or a run that starts, to end or to hear the stop
LOOK_S = 0.02
NOT_STARTED = "not started"  # instead of a vehicle's bearing air: its flight was called off
DEFAULT = "tcp/127.0.0.1:7450"  # the host's default endpoint
LAST_RESORT = """\
vehicles without a host brake and shut by themselves after one second
if a vehicle still moves: shut the main valve or pull the cord by hand
"""


class AskedFlight(NamedTuple):
    """A flight on the twin, or a run that starts, that was asked to end."""

    note: Path
    flight: StoppableFlight
    at: float  # by the monotonic clock [s]


def own_keys() -> Path:
    """The operator's key folder."""
    return Path.home() / ".airbearing-testbed"


def _of(keys: Path, connect: str | None) -> StoppableFlight:
    """The flight that the owner of a key folder can stop."""
    from testbed.net.credentials import read_credentials

    credentials = read_credentials(keys)
    if credentials.ending:
        complain(credentials.ending)
    return StoppableFlight(connect or credentials.endpoint, credentials.lab, str(keys))


def stop_everything(connect: str | None, lab: str, keys: Path | None = None) -> int:
    """Stop every flight that is found; returns the exit code.

    Args:
        connect: endpoint of a host; None: this machine, and the endpoint in the operator's keys.
        lab: first part of the network keys; used without a key folder.
        keys: key folder of an operator; None: the operator's usual folder, if one is needed.
    """
    from testbed.net.credentials import CredentialsError

    stopped: list[bool] = []
    asked: list[AskedFlight] = []
    try:
        if keys is None and connect and not connect.startswith(("tls/", "quic/")):
            stopped.append(_stop_wires(StoppableFlight(connect, lab)))
        elif keys is None and not connect:
            stopped += _stop_here(asked)
            if own_keys().exists():
                stopped.append(_stop_wires(_of(own_keys(), None)))
        else:
            stopped.append(_stop_wires(_of(keys or own_keys(), connect)))
    except CredentialsError as error:
        stopped.append(False)
        complain(str(error))
    stopped += _wait_for(asked)  # after all hosts: it may take long, and nothing moves on the twin
    if not stopped:
        complain("no flight on this machine; on another one: testbed stop --connect, or --keys")
    elif not all(stopped):
        sys.stderr.write(LAST_RESORT)
    return OK if stopped and all(stopped) else FAILED


def _stop_here(asked: list[AskedFlight]) -> Iterator[bool]:
    """Stop every flight on this machine, and a host at the default endpoint without a note.

    Args:
        asked: those on the twin that were asked to end are appended.
    """
    tried, killed = set(), []
    for note, flight in sorted(known_flights(), key=lambda one: not one[1].endpoint):
        # hosts first: they fly vehicles
        tried.add(flight.endpoint)
        if not runs(flight):
            killed.append((note, flight))
        elif flight.endpoint:
            yield _stop_wires(flight)
        elif _ask(note, flight):
            asked.append(AskedFlight(note, flight, monotonic()))
        else:
            yield False
    unknown = StoppableFlight(DEFAULT)  # perhaps there is one without a note
    if listens := DEFAULT not in tried and _listens(DEFAULT):
        yield _stop_wires(unknown)
    for note, flight in killed:  # after the others: one whose vehicles are gone takes DIRECT_S
        shut = set()
        if flight.endpoint:
            shut = _stop_directly(flight, _new_id())
            why = f"the host, process {flight.pid}, was killed"
            yield _report(flight, set(flight.vehicles), shut, why, {})
        if not shut:  # the second stop needs the note
            remove(note)
    if DEFAULT not in tried and not listens and (shut := _stop_directly(unknown, _new_id())):
        yield _report(unknown, set(), shut, "no host listens", {})


def _listens(endpoint: str) -> bool:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with suppress(OSError), socket.create_connection((host, int(port)), OPEN_S):
        return True
    return False


def end_twin(note: Path, flight: StoppableFlight) -> None:
    """Ask the process of a flight on the twin, or of a run that starts, to end it.

    Raises:
        OSError: it belongs to another user.
    """
    with suppress(FileNotFoundError, ProcessLookupError):  # the process has just ended
        if Path(f"/proc/{flight.pid}").stat().st_uid != note.stat().st_uid:
            raise PermissionError("its process belongs to another user")
        os.kill(flight.pid, signal.SIGTERM)


def _ask(note: Path, flight: StoppableFlight) -> bool:
    """Ask the process to end the flight; whether it could be asked."""
    try:
        end_twin(note, flight)
    except OSError as error:
        complain(f"{_named(flight)}: not asked: {error}")
        return False
    return True


def _wait_for(asked: Sequence[AskedFlight]) -> Iterator[bool]:
    """Wait for flights that were asked to end; whether each did.

    One that has heard the stop may take as long as its brake does.
    """
    left, told = list(asked), set[Path]()
    while left:
        for one in tuple(left):
            after_s, heard = monotonic() - one.at, heard_stop(one.note).exists()
            over = not one.note.exists() or not runs(one.flight)
            late_s = max(END_S, one.flight.ends_s) if heard else END_S
            if over or after_s > late_s:
                left.remove(one)
                words = "heard the stop and did not end" if heard else "did not answer"
                sys.stdout.write(f"{_named(one.flight)}: {'ended' if over else words}\n")
                yield over
            elif after_s > END_S and one.note not in told:
                told.add(one.note)
                words = f"stops within {late_s - after_s:.0f} s"
                sys.stdout.write(f"{_named(one.flight)}: {words}\n")
                sys.stdout.flush()
        threading.Event().wait(LOOK_S * bool(left))


def _named(flight: StoppableFlight) -> str:
    return f"{flight.name} on the {flight.rig}, process {flight.pid}"


def _new_id() -> str:
    """An id for a stop: its copies arrive by several routes and count once."""
    return secrets.token_hex(8)


def _stop_directly(flight: StoppableFlight, stop: str, wait_s: float = DIRECT_S) -> set[str]:
    """Stop the vehicles of a host without it; returns those that answered."""
    from testbed.net.direct_stop import stop_directly

    keys = Path(flight.keys) if flight.keys else None
    return stop_directly(flight.endpoint, flight.lab, keys, flight.vehicles, stop, wait_s)


def _stop_wires(flight: StoppableFlight) -> bool:
    """Stop a host and its vehicles; whether all of them stand."""
    stop, names, trouble = _new_id(), set(flight.vehicles), ""
    ended: dict[str, str] = {}
    shut = _stop_directly(flight, stop)  # first, because it is faster

    from testbed.net.session import NetworkError

    try:
        shut, names, ended = _stop_host(flight, stop, shut)
    except NetworkError as error:
        process = f", process {flight.pid}," if flight.pid else ""
        trouble = f"the host{process} did not answer: {error}"
        if late := names - shut:
            shut |= _stop_directly(flight._replace(vehicles=list(late)), stop, LATE_S)
    return _report(flight, names, shut, trouble, ended)


def _stop_host(
    flight: StoppableFlight, stop: str, shut: set[str]
) -> tuple[set[str], set[str], dict[str, str]]:
    """Stop a host and its vehicles over Zenoh, and those that do not answer also directly.

    Args:
        flight: of the host.
        stop: id of this stop.
        shut: vehicles that have answered.

    Returns:
        Vehicles that answered, all vehicles of the flight, and the bearing air of those that had
        ended their flight before.

    Raises:
        NetworkError: the host does not answer.
    """
    from testbed.net.keys import Keys
    from testbed.net.session import answers, dial

    keys, folder = Keys(flight.lab), Path(flight.keys) if flight.keys else None
    with dial(flight.endpoint, WAIT_S, folder, open_s=OPEN_S) as session:
        session.put(keys.stop, stop.encode())
        answered = answers(session, keys.stop, ANSWER_S, stop.encode())
        flown = _vehicles(answers(session, keys.experiment, ANSWER_S))
        names, ended, end = set(flight.vehicles or flown), dict[str, str](), monotonic() + LATE_S
        shut = shut | {data.decode(errors="replace") for data in answered}
        while (late := names - shut - ended.keys()) and monotonic() < end:
            ended = ended_vehicles(session, keys)
            if late := late - ended.keys():
                shut |= _stop_directly(flight._replace(vehicles=list(late)), stop)
    return shut, names, ended


def _report(
    flight: StoppableFlight, names: set[str], shut: set[str], trouble: str,
    ended: Mapping[str, str],
) -> bool:  # fmt: skip
    """Print which vehicles stopped, and the host's trouble; whether all vehicles stand."""
    if trouble and not shut:
        complain(f"{flight.endpoint}: not stopped: {trouble}")
        return False
    sys.stdout.write(f"{flight.endpoint}\n")
    for name in sorted({*names, *shut, *ended}):
        sys.stdout.write(f"  {name}: {answer_of(name, shut, ended)}\n")
    if trouble:
        sys.stdout.write(f"  stopped without the host: {trouble}\n")
    if shut:
        sys.stdout.write("  stop again to shut valves and air at once\n")
    if not shut and not names:
        sys.stdout.write("  no vehicle answered\n")
    stand = shut | {name for name, air in ended.items() if air in ("off", NOT_STARTED)}
    return bool(stand) and stand >= names


def answer_of(name: str, shut: Container[str], ended: Mapping[str, str]) -> str:
    """What a vehicle answered to a stop, or its host for it.

    Args:
        name: of the vehicle.
        shut: vehicles that answered.
        ended: bearing air of vehicles that had ended their flight before.
    """
    if name in shut:
        return "stops"
    if ended.get(name) == NOT_STARTED:
        return "does not start"
    return f"had ended, bearing air {ended[name]}" if name in ended else "did not answer"


def ended_vehicles(session: "zenoh.Session", keys: "Keys") -> dict[str, str]:
    """Bearing air, "off" or "on", of the vehicles that have ended their flight, by their host.

    NOT_STARTED: the host has called their flight off.
    """
    from testbed.net.session import answers

    with suppress(ValueError, AttributeError, IndexError, RecursionError):
        answer = answers(session, keys.ended, ANSWER_S)[0]
        return {str(name): str(air) for name, air in json.loads(answer).items()}
    return {}


def _vehicles(experiments: Sequence[bytes]) -> list[str]:
    """Vehicles in the host's experiment; empty if it cannot be read."""
    with suppress(ValueError, KeyError, TypeError, IndexError, RecursionError):
        return [str(name) for name in json.loads(experiments[0])["vehicles"]]
    return []
