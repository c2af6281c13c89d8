"""Ticks that were flown one after the other as rows of tables: a column is taken at once."""

from typing import Any, NamedTuple, Protocol, Self

from testbed.core.codes import FaultReport, Intervention
from testbed.flight.agent import Agent
from testbed.flight.flown_tick import FlownHostTick, FlownTick
from testbed.flight.tick_table import Array, HostTable, TickTable


class _Run:
    """Rows one after the other of one table; it grows."""

    __slots__ = ("count", "first", "names", "notes", "table")

    def __init__(self, table: Any, first: int, count: int, names: list[str]) -> None:
        self.table, self.first, self.count, self.names = table, first, count, names
        self.notes: dict[int, Any] = {}  # what a row does not have, by its place in the run

    def __len__(self) -> int:
        return self.count

    @property
    def rows(self) -> slice:
        """Where the run is in its table."""
        return slice(self.first, self.first + self.count)

    def goes_on(self, table: TickTable | HostTable, k: int) -> bool:
        """Whether row `k` of this table is the next one."""
        return self.table is table and k == self.first + self.count

    def _grow(self, count: int, notes: dict[int, Any]) -> None:
        self.notes |= {self.count + i: note for i, note in notes.items()}
        self.count += count

    def extend(self, more: Self) -> None:
        """Add the rows that come next."""
        self._grow(more.count, more.notes)

    def _cut(self, part: Self, begin: int) -> Self:
        end = begin + part.count
        part.notes = {i - begin: one for i, one in self.notes.items() if begin <= i < end}
        return part


class FlownRows(_Run):
    """Ticks of one vehicle. Notes are faults that end the run."""

    __slots__ = ("agent",)
    table: TickTable
    notes: dict[int, FaultReport]

    def __init__(
        self, table: TickTable, first: int, count: int, names: list[str], agent: Agent
    ) -> None:
        super().__init__(table, first, count, names)
        self.agent = agent

    @classmethod
    def of(cls, tick: FlownTick) -> "FlownRows":
        """The run that begins with a tick."""
        run = cls(tick.table, tick.k, 0, tick.names, tick.agent)
        run.add(tick)
        return run

    def add(self, tick: FlownTick) -> None:
        """Add the tick that comes next."""
        self._grow(1, {} if tick.fault is None else {0: tick.fault})

    def __getitem__(self, i: int) -> FlownTick:
        k = self.first + i
        record = self.table.records[k]
        t, shut = float(record.inputs.t), bool(record.outputs.inhibit)
        return FlownTick(
            self.table, k, t, self.agent, self.names, shut=shut, fault=self.notes.get(i)
        )

    def part(self, begin: int, end: int) -> "FlownRows":
        """The ticks from place `begin` to `end`."""
        first, count = self.first + begin, end - begin
        return self._cut(FlownRows(self.table, first, count, self.names, self.agent), begin)


class FlownHostRows(_Run):
    """Ticks of one law on the host. Notes are changes of the reference model's force."""

    __slots__ = ()
    table: HostTable
    notes: dict[int, Intervention]

    @classmethod
    def of(cls, tick: FlownHostTick) -> "FlownHostRows":
        """The run that begins with a tick."""
        run = cls(tick.table, tick.k, 0, tick.names)
        run.add(tick)
        return run

    def add(self, tick: FlownHostTick) -> None:
        """Add the tick that comes next."""
        self._grow(1, {} if tick.filtered is None else {0: tick.filtered})

    def __getitem__(self, i: int) -> FlownHostTick:
        k = self.first + i
        own_t = float(self.table.own[k, 0])
        return FlownHostTick(self.table, k, self.names, own_t, self.notes.get(i))

    def part(self, begin: int, end: int) -> "FlownHostRows":
        """The ticks from place `begin` to `end`."""
        first, count = self.first + begin, end - begin
        return self._cut(FlownHostRows(self.table, first, count, self.names), begin)


class Shown(Protocol):
    """What `FlownSpan.show` needs of an observer."""

    def vehicle(self, name: str, tick: FlownTick) -> None:
        """See `loop.Observer`."""
        ...

    def host(self, name: str, tick: FlownHostTick) -> None:
        """See `loop.Observer`."""
        ...

    def done(self, t: float) -> None:
        """See `loop.Observer`."""
        ...


class FlownSpan(NamedTuple):
    """Ticks of all vehicles and their laws, none of which ends the flight."""

    times: list[float]  # [s]
    vehicles: dict[str, FlownRows]
    hosts: dict[str, FlownHostRows]
    truth: Array  # true states of the vehicles at these times, (n, v, 6)

    def show(self, observer: Shown, begin: int = 0) -> None:
        """Show an observer one tick after the other, from place `begin` on."""
        for i in range(begin, len(self.times)):
            for name, rows in self.vehicles.items():
                observer.vehicle(name, rows[i])
            for name, answers in self.hosts.items():
                observer.host(name, answers[i])
            observer.done(self.times[i])

    def part(self, begin: int, end: int) -> "FlownSpan":
        """The ticks from place `begin` to `end`."""
        if begin == 0 and end == len(self.times):
            return self
        return FlownSpan(
            self.times[begin:end],
            {name: rows.part(begin, end) for name, rows in self.vehicles.items()},
            {name: rows.part(begin, end) for name, rows in self.hosts.items()},
            self.truth[begin:end],
        )
