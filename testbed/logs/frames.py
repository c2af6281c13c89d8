"""What the recorder sends to the writer's process; small, because that process starts first."""

from collections.abc import Iterator

from msgspec import Struct

READY = b"ready\n"  # the writer's first line
FULL = "full: "  # before the reason, in the writer's line that the flight must end


class Epoch(Struct, frozen=True, tag=True, array_like=True):
    """To the writer, before the first topic: UTC at time 0 of the run [ns]."""

    utc_ns: int


class Topic(Struct, frozen=True, tag=True, array_like=True):
    """To the writer: a new topic; topics are numbered in the order of these messages."""

    name: str
    kind: str  # of its messages, see `core/records`


class One(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """One message of a topic."""

    topic: int
    stamp: int  # time of the run [ns]
    data: bytes

    def __len__(self) -> int:
        return 1


class Stack(Struct, frozen=True, array_like=True, gc=False):
    """Messages of one size, one after the other, with spare bytes before each."""

    pitch: int  # from one to the next [bytes]
    spare: int  # bytes before each
    data: memoryview

    def __len__(self) -> int:
        return len(self.data) // self.pitch

    def __iter__(self) -> Iterator[memoryview]:
        for at in range(0, len(self.data), self.pitch):
            yield self.data[at + self.spare : at + self.pitch]

    def part(self, begin: int, end: int) -> "Stack":
        """The messages from place `begin` to `end`."""
        return Stack(self.pitch, self.spare, self.data[begin * self.pitch : end * self.pitch])


class Table(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """Messages of several topics at the same times: time by time, in the order of the topics."""

    topics: list[int]
    stamps: list[int]  # times of the run [ns]
    columns: list[list[Stack]]  # of each topic, with a message for each time
    between: list[tuple[int, One]]  # more messages, each before the time at this place

    def __len__(self) -> int:
        return len(self.topics) * len(self.stamps) + len(self.between)


class Messages(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: messages in order."""

    parts: list[One | Table]

    def __len__(self) -> int:
        return sum(map(len, self.parts))


class Mark(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: flush, so that a reader can see everything so far."""


Frame = Epoch | Topic | Messages | Mark
