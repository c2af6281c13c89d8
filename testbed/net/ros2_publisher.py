"""Publishes a run to ROS 2: every message of its log, during the flight or afterwards.

    python -m testbed.net.ros2_publisher RUN ENDPOINT DOMAIN

It follows the log, so a slow or dead listener never delays the flight, and it cannot command: it
subscribes to nothing. Beside the log's topics it publishes

    /<vehicle>/state       testbed_msgs/State       the estimate
    /<vehicle>/reference   testbed_msgs/Reference   input of the tracker, if it is a reference

which are parts of a tick's row, and the log's standard messages (logs/extras.py) at each tick
instead of twice a second. Messages that are said once are repeated for late listeners.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from time import monotonic
from typing import NamedTuple

from testbed.core.records.definition import DTYPES, MESSAGES
from testbed.core.records.kinds import Active
from testbed.core.records.layout import HEADER
from testbed.core.records.ros import schema_text
from testbed.logs.extras import Extras
from testbed.logs.log_reader import LogError, LogReader, await_log, log_of
from testbed.net.ros2 import Ros2Node
from testbed.net.session import NetworkError, NoHostError, dial

PERIOD_S = 0.02  # between two looks at the log
REPEAT_S = 1.0
ONCE = ("/scene", "/names")  # topics that are repeated
WAIT_S = 1.0  # for a router, at each attempt


class Slice(NamedTuple):
    """A message that is a part of a tick's row."""

    name: str  # last part of its topic
    kind: str
    known: int  # place of the byte that says whether it is there [bytes]
    value: int  # of that byte
    begin: int  # its place [bytes]
    end: int


def _place(*path: str) -> int:
    """Place of a field in a tick's message [bytes]."""
    at, kind = len(HEADER), "Tick"
    for name in path:
        fields = DTYPES[kind].fields
        assert fields is not None
        at += fields[name][1]
        kind = next(one.kind for one in MESSAGES[kind].fields if one.name == name)
    return at


def _slice(name: str, kind: str, known: str, value: int) -> Slice:
    begin = _place("outputs", name)
    end = begin + DTYPES[kind].itemsize
    return Slice(name, kind, _place("outputs", known), value, begin, end)


SLICES = (
    _slice("state", "State", "state_known", 1),
    _slice("reference", "Reference", "active", Active.REFERENCE),
)


class Message(NamedTuple):
    """A message for ROS 2."""

    topic: str
    kind: str
    stamp: int  # UTC [ns]
    data: bytes


def messages(log: LogReader, extras: Extras) -> Iterator[Message]:
    """New messages of a log for ROS 2.

    Raises:
        LogError: the log cannot be read, or is of another version.
    """
    for topic, stamp, data in log.read():
        kind, at = log.kinds[topic], log.epoch + stamp
        if "/" in kind and topic not in ONCE:
            continue  # `extras` makes them, at each tick
        if log.texts[topic] != schema_text(kind):
            raise LogError(
                where=f"{log.path}: {topic}", expected=f"messages {kind} of this version",
                found="another version of them", hint="ros2 bag play reads this file",
            )  # fmt: skip
        yield Message(topic, kind, at, data)
        for name, standard, extra in extras.of(topic, kind, at, data):
            yield Message(name, standard, at, extra)
        if kind == "Tick" and topic.endswith("/tick"):
            for one in SLICES:
                if data[one.known] == one.value:
                    name = topic.removesuffix("tick") + one.name
                    yield Message(name, one.kind, at, HEADER + data[one.begin : one.end])


def publish(
    log: LogReader,
    node: Ros2Node,
    now: Callable[[], float],
    pause: Callable[[float], object],
    speed: float | None = None,
) -> int:
    """Publish a log until it is complete; returns the number of its messages.

    Args:
        log: from where it has been read to.
        node: that publishes.
        now: time of this machine, monotonic [s].
        pause: waits so long [s].
        speed: of a finished run, as a multiple of real time; None: as it is written.
    """
    once: dict[str, Message] = {}
    extras = Extras(every_ns=0)  # their stamps are UTC already
    repeated = began = now()
    first: int | None = None
    number = 0

    def repeat() -> None:
        nonlocal repeated
        if now() - repeated >= REPEAT_S:
            repeated = now()
            for one in once.values():
                node.publish(*one)

    while True:
        for one in messages(log, extras):
            first = one.stamp if first is None else first
            due = began if speed is None else began + 1e-9 * (one.stamp - first) / speed
            while (early := due - now()) > 0.0:
                pause(min(early, PERIOD_S))
                repeat()
            node.publish(*one)
            number += 1
            if one.topic in ONCE:
                once[one.topic] = one
        repeat()
        if log.finished:
            return number
        pause(PERIOD_S)


def beside(run: Path, endpoint: str, domain: int) -> None:
    """Publish a flight from its beginning, as soon as the log and a router are there."""
    log, waiting = await_log(log_of(run)), False
    while True:
        try:
            session = dial(endpoint, WAIT_S)
            break
        except NoHostError:
            if not waiting:
                sys.stderr.write(f"ros2: waiting for a router at {endpoint}: {ROUTER}\n")
                waiting = True
    with session:
        publish(log, Ros2Node(session, domain), monotonic, Event().wait)


ROUTER = "start `ros2 run rmw_zenoh_cpp rmw_zenohd`"


def main() -> int:
    """Publish until the log is complete; returns the exit code and writes errors to stderr."""
    try:
        beside(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
    except (LogError, NetworkError) as error:
        sys.stderr.write(f"ros2: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
