"""Messages that wait until the rows of many ticks are made together."""

from typing import Any

from testbed.flight.flown_tick import FlownHostTick, FlownTick
from testbed.flight.tick_table import TICKS
from testbed.logs.table_rows import TableRows
from testbed.logs.tick_row import Made, RowWriter

LARGEST = 10 * TICKS  # messages; about a table of each of ten topics

Waiting = tuple[float, str, FlownTick | FlownHostTick | Made]  # time [s], topic, message


class Block:
    """Ticks that are rows of tables, and what was written between them, in order."""

    def __init__(self, writer: RowWriter) -> None:
        self._writer = writer
        self._waiting: list[Waiting] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, t: float, topic: str, message: FlownTick | FlownHostTick | Made) -> None:
        """Append a message of time `t` [s]."""
        self._waiting.append((t, topic, message))

    def take(self) -> list[tuple[float, Made]]:
        """All messages so far, with times [s]; rows of one table are made together."""
        waiting, self._waiting = self._waiting, []
        ticks: dict[tuple[str, int], list[Any]] = {}
        for _, topic, one in waiting:
            if not isinstance(one, Made):
                ticks.setdefault((topic, id(one.table)), []).append(one)
        rows = {}
        for (topic, table), those in ticks.items():
            rows[topic, table] = iter(TableRows(self._writer, topic).messages(those))
        taken = []
        for t, topic, one in waiting:
            if not isinstance(one, Made):
                kind = "Tick" if isinstance(one, FlownTick) else "HostTick"
                one = Made(topic, kind, next(rows[topic, id(one.table)]))
            taken.append((t, one))
        return taken
