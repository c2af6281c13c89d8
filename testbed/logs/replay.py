"""Replays a logged run with the present code: same inputs, outputs compared to the last bit.

Agents and laws are pure steps, so the same code must give the same outputs. Only the first
difference is reported, with its size: after it the two flights drift apart.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import msgspec
from msgspec import Struct

from testbed.core.rows import structs_of
from testbed.core.types import (
    HostInputs,
    HostTick,
    Inputs,
    LawMessage,
    Outputs,
    Setpoint,
    State,
)
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader, Row
from testbed.logs.row_reader import RowReader
from testbed.logs.stage import stage_of
from testbed.logs.tick_row import RowWriter


class Difference(Struct, frozen=True):
    """First difference between two flights."""

    tick: int  # of the run, from 0
    t: float  # [s]
    topic: str
    field: str  # path inside the message, or why it cannot be compared
    logged: Any
    now: Any
    size: float | None  # |now - logged|, for numbers
    stage: str = ""  # of the chain, see stage.py


class Replay(Struct, frozen=True, omit_defaults=True):
    """How many ticks were compared, and the first difference."""

    ticks: int  # of all topics together
    first_difference: Difference | None
    whole: bool = True  # false: part of the log is missing; the rest was not compared


class LoggedLink:
    """A `HostLink` that returns the messages of the log."""

    def __init__(self) -> None:
        self.inputs: HostInputs | None = None

    def own(self) -> State | None:
        """See `HostLink`."""
        assert self.inputs is not None
        return self.inputs.own

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        assert self.inputs is not None
        return dict(self.inputs.neighbours)

    def messages(self) -> dict[str, LawMessage]:
        """See `HostLink`."""
        assert self.inputs is not None
        return dict(self.inputs.messages)

    def publish(self, setpoint: Setpoint) -> None:
        """See `HostLink`; dropped here."""

    def broadcast(self, message: LawMessage) -> None:
        """See `HostLink`; dropped here."""


Onboard = Callable[[Inputs], Outputs]  # one vehicle's agent
AtHost = Callable[[float], HostTick]  # one vehicle's law on a link


class LoggedHost:
    """One law on the host, fed from the log."""

    def __init__(self, plug: Callable[[LoggedLink], AtHost]) -> None:
        self._link = LoggedLink()
        self._tick = plug(self._link)

    def __call__(self, inputs: HostInputs) -> HostTick:
        """Run one tick with the present code."""
        self._link.inputs = inputs
        return self._tick(inputs.t)


def replay(
    rows: Iterable[Row], agents: Mapping[str, Onboard], hosts: Mapping[str, LoggedHost]
) -> Replay:
    """Replay a log.

    Args:
        rows: of the log, in its order.
        agents: per vehicle, its step.
        hosts: per vehicle whose law runs on the host.

    Raises:
        LogError: the log has ticks of a vehicle or law that is not in the experiment.
    """
    count, first, read = 0, None, RowReader()
    then_rows, now_rows = RowWriter(), RowWriter()
    seen: dict[str, int] = {}
    for topic, stamp, data in rows:
        name, _, kind = topic.removeprefix("/").rpartition("/")
        if kind not in ("tick", "ending", "host"):
            with _readable(topic, stamp):
                read.learn(topic, {"names": "Names", "event": "Event"}.get(kind, ""), data)
            continue
        then: Any
        now: Any
        with _readable(topic, stamp):
            then = read.host(topic, data) if kind == "host" else read.tick(topic, data)
        if kind != "host":
            now = type(then)(then.inputs, _known(agents, name, topic)(then.inputs))
        else:
            law = _known(hosts, name, topic)
            now = law(then.inputs) if _is_repeated(then) else then
        chain = f"/{name}/host" if kind == "host" else f"/{name}/tick"  # the ending goes on with it
        tick = seen[chain] = seen.get(chain, -1) + 1
        count += 1
        t = then.inputs.t
        if then_rows.rows(topic, t, then) == now_rows.rows(topic, t, now):
            continue
        if first is None or tick < first.tick:
            first = parting(tick, topic, then, now, law_on_board=not hosts) or first
    if count == 0:
        raise LogError("there are no ticks in the log")
    return Replay(count, first)


def _is_repeated(tick: HostTick) -> bool:
    """Whether to run this tick again.

    A host that is not armed does not call its law. The log does not say whether it was armed, but
    a law that was called has given a setpoint or a fault.
    """
    out = tick.outputs
    return tick.inputs.own is None or out.setpoint is not None or out.fault is not None


def parting(tick: int, topic: str, then: Any, now: Any, *, law_on_board: bool) -> Difference | None:
    """Where the outputs of two ticks differ; None: nowhere."""
    before, after = (msgspec.to_builtins(one.outputs, enc_hook=structs_of) for one in (then, now))
    host = isinstance(then, HostTick)
    stage, key = stage_of(before, after, on_host=host, law_on_board=law_on_board)
    if not stage:
        return None
    found = difference(before.get(key), after.get(key), key)
    assert found is not None, "the stage's field differs"
    return Difference(tick, then.inputs.t, topic, *found, stage)


def before_damage(book: LogReader) -> Iterator[Row]:
    """The rows of a log up to the first missing one.

    Later rows cannot be compared: the memory of agents and laws depends on the missing inputs.

    Raises:
        LogError: the beginning is missing.
    """
    begun = False
    for row in book.read():
        if book.lost:
            break
        begun = True
        yield row
    if book.lost and not begun:
        raise LogError(
            where=str(book.path), expected="a log that is whole from its beginning to some tick",
            found="damage before the first tick; later ticks depend on the missing part",
        )  # fmt: skip


def _known(steps: Mapping[str, Any], name: str, topic: str) -> Any:
    if name not in steps:
        raise LogError(
            f"{topic} is in the log, but the experiment has no such "
            "vehicle or runs its law elsewhere (deploy.law)"
        )
    return steps[name]


@contextmanager
def _readable(topic: str, stamp: int) -> Iterator[None]:
    """Say where a row is that cannot be read."""
    try:
        yield
    except UNREADABLE as error:
        raise LogError(
            where=f"{topic} at {stamp * 1e-9:.3f} s", expected="a message of this version",
            found=str(error),
        ) from None  # fmt: skip


def difference(then: Any, now: Any, path: str = "") -> tuple[str, Any, Any, float | None] | None:
    """The first place where two messages differ: path, both values, and the size for numbers."""
    match then, now:
        case dict(), dict():
            keys = [*then, *(key for key in now if key not in then)]
            for key in keys:
                inner = f"{path}.{key}" if path else str(key)
                if found := difference(then.get(key), now.get(key), inner):
                    return found
            return None
        case (list() | tuple(), list() | tuple()):
            for k in range(max(len(then), len(now))):
                a, b = then[k] if k < len(then) else None, now[k] if k < len(now) else None
                if found := difference(a, b, f"{path}[{k}]"):
                    return found
            return None
    if repr(then) == repr(now):  # nan is nan here, and -0.0 is not 0.0
        return None
    both = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (then, now))
    return path, then, now, abs(now - then) if both else None
