"""Log of record: every tick's inputs and outputs in one MCAP file.

    /<vehicle>/tick    one tick of the flight chain: inputs and outputs
    /<vehicle>/host    one tick of its law, where that runs on the host
    /<vehicle>/valves  what its board drove, where firmware is in the loop
    /truth             where the vehicles really were; only a twin knows

JSON messages, each topic with the JSON Schema of its struct: any MCAP reader can open it without
this code. Times are the run's, so the same seed gives the same bytes.

The file is written by a process of its own (`scribe.py`) at the other end of a pipe: the flight
does not wait for the disk, and when it is killed, the scribe still finishes the file.
"""

import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec
from msgspec import Struct

BUFFER = 256 * 1024  # [bytes] between the flight and the scribe; a third of a second of messages


class RecorderError(Exception):
    """The log cannot be written, for instance because the disk is full."""


class Motion(Struct, frozen=True, gc=False):
    """Pose and twist of one vehicle in W."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Truth(Struct, frozen=True, gc=False):
    """Where the vehicles really are at a tick."""

    t: float  # [s]
    vehicles: dict[str, Motion]


class Topic(Struct, frozen=True, tag=True, array_like=True):
    """To the scribe: a new topic; topics are numbered in the order in which they are announced."""

    name: str
    schema_name: str
    schema: bytes


class Entry(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the scribe: one message of a topic."""

    topic: int
    stamp: int  # [ns]
    data: bytes


Frame = Topic | Entry


class Recorder:
    """Writes a log; a context manager that finishes the file however the flight ends.

    Raises:
        RecorderError: on leaving or writing, when the scribe could not do its work.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._encode = msgspec.json.Encoder().encode
        self._pack = msgspec.msgpack.Encoder().encode
        self._topics: dict[str, int] = {}

    def __enter__(self) -> "Recorder":
        self._scribe = subprocess.Popen(
            [sys.executable, "-m", "testbed.ops.scribe", str(self._path)],
            bufsize=BUFFER,
            pipesize=BUFFER,
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the flight; the scribe ends when the pipe does
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        _, said = self._scribe.communicate()
        if self._scribe.returncode != 0 and kind is None:
            raise RecorderError(said.decode().strip())

    def write(self, topic: str, t: float, message: Struct) -> None:
        """Append one message of time `t` [s] to `topic`."""
        number = self._topics.get(topic)
        if number is None:
            number = self._topics[topic] = len(self._topics)
            kind = type(message)
            self._send(Topic(topic, kind.__name__, self._encode(json_schema(kind))))
        self._send(Entry(number, round(t * 1e9), self._encode(message)))

    def _send(self, frame: Frame) -> None:
        assert self._scribe.stdin is not None
        packed = self._pack(frame)
        try:
            self._scribe.stdin.write(len(packed).to_bytes(4, "little"))
            self._scribe.stdin.write(packed)
        except BrokenPipeError:
            _, said = self._scribe.communicate()
            raise RecorderError(said.decode().strip()) from None


def json_schema(kind: type[Struct]) -> dict[str, Any]:
    """JSON Schema whose top level is an object, as MCAP readers expect it."""
    schema = msgspec.json.schema(kind)
    definitions = schema.pop("$defs")
    top = definitions.pop(kind.__name__)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **top, "$defs": definitions}
