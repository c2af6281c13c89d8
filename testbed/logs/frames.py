"""What the recorder sends to the writer's process; small, because that process starts first."""

from msgspec import Struct

READY = b"ready\n"  # the writer's first line


class Topic(Struct, frozen=True, tag=True, array_like=True):
    """To the writer: a new topic; topics are numbered in the order of these messages."""

    name: str
    kind: str  # of its messages, see `core/records`


class Entry(Struct, frozen=True, array_like=True, gc=False):
    """One message of a topic."""

    topic: int
    stamp: int  # time of the run [ns]
    data: bytes


class Entries(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: messages in order."""

    entries: list[Entry]


class Mark(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: flush, so that a reader can see everything so far."""


Frame = Topic | Entries | Mark
