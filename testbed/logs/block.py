"""Messages that wait until the rows of many ticks are made together."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from msgspec import Struct

from testbed.flight.flown_span import FlownHostRows, FlownRows, FlownSpan
from testbed.flight.flown_tick import FlownHostTick, FlownTick
from testbed.flight.tick_table import TICKS
from testbed.logs.frames import Stack
from testbed.logs.table_rows import TableRows
from testbed.logs.tick_row import Made, RowWriter

LARGEST = 10 * TICKS  # messages; about a table of each of ten topics

Key = tuple[str, int]  # topic, and which table
TRUTH: Key = ("/truth", 0)
Runs = dict[Key, Any]  # FlownRows of vehicles, FlownHostRows of laws
Later = Callable[[], Mapping[float, Struct]]  # gives messages, by time [s]


class Column(NamedTuple):
    """Messages of one topic, one for each tick."""

    topic: str
    kind: str
    stacks: list[Stack]


class Columns(NamedTuple):
    """Messages of several topics at the same ticks: tick by tick, in the order of the topics."""

    times: list[float]  # [s]
    columns: list[Column]
    between: list[tuple[int, float, Made]]  # more messages: before which tick, time [s]


Piece = tuple[float, Made] | Columns


def nothing() -> Mapping[float, Struct]:
    """No messages."""
    return {}


class _One(NamedTuple):
    """A message of time `t` [s]."""

    t: float
    topic: str
    message: FlownTick | FlownHostTick | Made

    def runs(self) -> Runs:
        """The row of a table that it is, if it is one."""
        one = self.message
        if isinstance(one, Made):
            return {}
        rows = FlownRows.of(one) if isinstance(one, FlownTick) else FlownHostRows.of(one)
        return {(self.topic, id(one.table)): rows}


class _Span(NamedTuple):
    """Ticks that were flown together; names before some of them, and messages of `topic` after."""

    span: FlownSpan
    before: Mapping[float, list[Made]]
    topic: str
    later: Later

    def runs(self) -> Runs:
        """The rows of tables that they are."""
        span = self.span
        vehicles = {(f"/{n}/tick", id(rows.table)): rows for n, rows in span.vehicles.items()}
        return vehicles | {(f"/{n}/host", id(rows.table)): rows for n, rows in span.hosts.items()}


class _Queue:
    """The messages of one topic that have been made, in order."""

    def __init__(self, stacks: list[Stack]) -> None:
        self._stacks = stacks[::-1]

    def take(self, number: int) -> list[Stack]:
        """The next `number` messages, in stacks."""
        taken = []
        while number > 0:
            stack = self._stacks.pop()
            if len(stack) > number:
                self._stacks.append(stack.part(number, len(stack)))
                stack = stack.part(0, number)
            taken.append(stack)
            number -= len(stack)
        return taken


class Block:
    """Ticks that are rows of tables, and what was written between them, in order."""

    def __init__(self, writer: RowWriter) -> None:
        self._writer, self._number = writer, 0
        self._waiting: list[_One | _Span] = []

    def __len__(self) -> int:
        return self._number

    def add(self, t: float, topic: str, message: FlownTick | FlownHostTick | Made) -> None:
        """Append a message of time `t` [s]."""
        self._waiting.append(_One(t, topic, message))
        self._number += 1

    def add_span(self, span: FlownSpan, topic: str = "", later: Later = nothing) -> None:
        """Append ticks that were flown together, and the truth after each.

        Args:
            span: the ticks.
            topic: of the messages that `later` gives.
            later: gives messages after some of the ticks, by time [s]; called when rows are made.
        """
        before = self._writer.new_names_in(span.times)
        self._waiting.append(_Span(span, before, topic, later))
        self._number += len(span.times) * (1 + len(span.vehicles) + len(span.hosts))

    def take(self) -> list[Piece]:
        """All messages so far, in order; rows of one table are made together."""
        waiting, self._waiting, self._number = self._waiting, [], 0
        spans = [one for one in waiting if isinstance(one, _Span)]
        between = [self._between(one) for one in spans][::-1]
        runs = [one.runs() for one in waiting]
        joined: Runs = {}
        for some in runs:
            for key, rows in some.items():
                if key in joined:
                    joined[key].extend(rows)
                else:
                    joined[key] = rows.part(0, len(rows))
        made = {
            key: _Queue(TableRows(self._writer, key[0]).messages(rows))
            for key, rows in joined.items()
        }
        if spans:
            truth = TableRows(self._writer, "/truth").truth([one.span for one in spans])
            made[TRUTH] = _Queue([truth])
        taken: list[Piece] = []
        for one, some in zip(waiting, runs, strict=True):
            if isinstance(one, _Span):
                times, keys = one.span.times, [*some, TRUTH]
                columns = [Column(k[0], kind_of(k[0]), made[k].take(len(times))) for k in keys]
                taken.append(Columns(times, columns, between.pop()))
            elif isinstance(one.message, Made):
                taken.append((one.t, one.message))
            else:
                (stack,) = made[one.topic, id(one.message.table)].take(1)
                (data,) = stack
                taken.append((one.t, Made(one.topic, kind_of(one.topic), bytes(data))))
        return taken

    def _between(self, one: _Span) -> list[tuple[int, float, Made]]:
        """The messages before and after some ticks of a span."""
        more, found = one.later(), []
        for k, t in enumerate(one.span.times):
            found += [(k, t, made) for made in one.before.get(t, ())]
            if t in more:
                found += [(k + 1, t, made) for made in self._writer.rows(one.topic, t, more[t])]
        return found


def kind_of(topic: str) -> str:
    """Kind of the rows of a topic."""
    if topic == TRUTH[0]:
        return "Truth"
    return "HostTick" if topic.endswith("/host") else "Tick"
