"""Messages that wait until the rows of many ticks are made together."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from msgspec import Struct

from testbed.flight.flown_span import FlownHostRows, FlownRows, FlownSpan
from testbed.flight.flown_tick import FlownHostTick, FlownTick
from testbed.flight.tick_table import TICKS
from testbed.logs.table_rows import TableRows
from testbed.logs.tick_row import Made, RowWriter

LARGEST = 10 * TICKS  # messages; about a table of each of ten topics

Key = tuple[str, int]  # topic, and which table
Runs = dict[Key, Any]  # FlownRows of vehicles, FlownHostRows of laws


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
    """Ticks that were flown together, and messages before and after some of them, by time [s]."""

    span: FlownSpan
    before: Mapping[float, list[Made]]
    after: Mapping[float, list[Made]]

    def runs(self) -> Runs:
        """The rows of tables that they are."""
        span = self.span
        vehicles = {(f"/{n}/tick", id(rows.table)): rows for n, rows in span.vehicles.items()}
        return vehicles | {(f"/{n}/host", id(rows.table)): rows for n, rows in span.hosts.items()}


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

    def add_span(self, span: FlownSpan, topic: str, messages: Mapping[float, Struct]) -> None:
        """Append ticks that were flown together, and the truth after each.

        Args:
            span: the ticks.
            topic: of `messages`.
            messages: after some of the ticks, by time [s].
        """
        writer, before, after = self._writer, {}, {}
        for t in span.times:
            if made := writer.new_names(t):
                before[t] = made
            if t in messages:
                after[t] = writer.rows(topic, t, messages[t])
        self._waiting.append(_Span(span, before, after))
        self._number += len(span.times) * (1 + len(span.vehicles) + len(span.hosts))

    def take(self) -> list[tuple[float, Made]]:
        """All messages so far, with times [s]; rows of one table are made together."""
        waiting, self._waiting, self._number = self._waiting, [], 0
        joined: Runs = {}
        for one in waiting:
            for key, rows in one.runs().items():
                if key in joined:
                    joined[key].extend(rows)
                else:
                    joined[key] = rows.part(0, len(rows))
        made = {key: TableRows(self._writer, key[0]).messages(rows) for key, rows in joined.items()}
        taken: list[tuple[float, Made]] = []
        for one in waiting:
            if isinstance(one, _Span):
                taken += self._of_span(one, made)
            elif isinstance(one.message, Made):
                taken.append((one.t, one.message))
            else:
                data = next(made[one.topic, id(one.message.table)])
                taken.append((one.t, Made(one.topic, kind_of(one.topic), data)))
        return taken

    def _of_span(
        self, one: _Span, made: Mapping[Key, Iterator[bytes]]
    ) -> Iterator[tuple[float, Made]]:
        topics = [(key[0], kind_of(key[0]), made[key]) for key in one.runs()]
        topics.append(("/truth", "Truth", TableRows(self._writer, "/truth").truth(one.span)))
        for t in one.span.times:
            yield from ((t, more) for more in one.before.get(t, ()))
            for topic, kind, data in topics:
                yield t, Made(topic, kind, next(data))
            yield from ((t, more) for more in one.after.get(t, ()))


def kind_of(topic: str) -> str:
    """Kind of the rows of a vehicle's topic."""
    return "HostTick" if topic.endswith("/host") else "Tick"
