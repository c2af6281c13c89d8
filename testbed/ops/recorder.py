"""Log of record: every tick's inputs and outputs in one MCAP file.

    /<vehicle>/tick    one tick of the flight chain: inputs and outputs
    /<vehicle>/host    one tick of its law, where that runs on the host
    /truth             where the vehicles really were; only a twin knows

JSON messages, each topic with the JSON Schema of its struct: any MCAP reader can open it without
this code. Times are the run's, so the same seed gives the same
bytes.
"""

from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec
from mcap.writer import CompressionType, Writer
from msgspec import Struct

CHUNK = 256 * 1024  # [bytes] at most this much is lost when the machine dies


class Motion(Struct, frozen=True):
    """Pose and twist of one vehicle in W."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Truth(Struct, frozen=True):
    """Where the vehicles really are at a tick."""

    t: float  # [s]
    vehicles: dict[str, Motion]


class Recorder:
    """Writes a log; a context manager that finishes the file however the flight ends."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb")  # never over an older log
        self._writer = Writer(self._file, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._encoder = msgspec.json.Encoder()
        self._channels: dict[str, int] = {}
        self._sequence = 0

    def __enter__(self) -> "Recorder":
        self._writer.start(profile="", library="airbearing-testbed")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.finish()
        self._file.close()

    def write(self, topic: str, t: float, message: Struct) -> None:
        """Append one message of time `t` to `topic`."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._register(topic, type(message))
        stamp = round(t * 1e9)
        self._sequence += 1
        data = self._encoder.encode(message)
        self._writer.add_message(channel, stamp, data, stamp, self._sequence)

    def _register(self, topic: str, kind: type[Struct]) -> int:
        schema = msgspec.json.encode(json_schema(kind))
        number = self._writer.register_schema(kind.__name__, "jsonschema", schema)
        return self._writer.register_channel(topic, "json", number)


def json_schema(kind: type[Struct]) -> dict[str, Any]:
    """JSON Schema whose top level is an object, as MCAP readers expect it."""
    schema = msgspec.json.schema(kind)
    definitions = schema.pop("$defs")
    top = definitions.pop(kind.__name__)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **top, "$defs": definitions}
