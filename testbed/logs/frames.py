"""What the recorder sends to the writer's process; small, because that process starts first."""

from msgspec import Struct

READY = b"ready\n"  # the writer's first line


class Epoch(Struct, frozen=True, tag=True, array_like=True):
    """To the writer, before the first topic: UTC at time 0 of the run [ns]."""

    utc_ns: int


class Topic(Struct, frozen=True, tag=True, array_like=True):
    """To the writer: a new topic; topics are numbered in the order of these messages."""

    name: str
    kind: str  # of its messages, see `core/records`


class Rows(Struct, frozen=True, array_like=True, gc=False):
    """Messages of several topics at the same times: time by time, in the order of the topics."""

    topics: list[int]
    stamps: list[int]  # times of the run [ns]
    data: list[list[bytes]]  # of each topic, one for each time


class Messages(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: messages in order."""

    rows: list[Rows]

    def __len__(self) -> int:
        return sum(len(one.topics) * len(one.stamps) for one in self.rows)


class Mark(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: flush, so that a reader can see everything so far."""


Frame = Epoch | Topic | Messages | Mark
