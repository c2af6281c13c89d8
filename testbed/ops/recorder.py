"""Log of record: every tick's inputs and outputs in one MCAP file.

One topic per vehicle and direction, JSON messages, each topic with the JSON Schema of its struct:
any MCAP reader can open it without this code. Times are the run's, so the same seed gives the same
bytes.
"""

from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec
from mcap.writer import CompressionType, Writer
from msgspec import Struct

from testbed.core.types import HostInputs, HostOutputs, Inputs, Outputs

CHUNK = 256 * 1024  # [bytes] at most this much is lost when the machine dies


class TruthRow(Struct, frozen=True):
    """True state of one vehicle; only a twin knows it."""

    t: float  # [s]
    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


TOPICS: dict[str, type[Struct]] = {
    "inputs": Inputs,
    "outputs": Outputs,
    "host_inputs": HostInputs,
    "host_outputs": HostOutputs,
    "truth": TruthRow,
}


class Recorder:
    """Writes a log; a context manager that finishes the file however the flight ends."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb")  # never over an older log
        self._writer = Writer(self._file, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._encoder = msgspec.json.Encoder()
        self._channels: dict[tuple[str, str], tuple[int, int]] = {}  # -> (channel, messages so far)
        self._schemas: dict[str, int] = {}

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

    def write(self, vehicle: str, topic: str, t: float, message: Struct) -> None:
        """Append one message to `/vehicle/topic`."""
        channel, count = self._channels.get((vehicle, topic)) or (self._register(vehicle, topic), 0)
        self._channels[vehicle, topic] = channel, count + 1
        stamp = round(t * 1e9)
        self._writer.add_message(channel, stamp, self._encoder.encode(message), stamp, count)

    def _register(self, vehicle: str, topic: str) -> int:
        if topic not in self._schemas:
            kind = TOPICS[topic]
            schema = msgspec.json.encode(json_schema(kind))
            self._schemas[topic] = self._writer.register_schema(kind.__name__, "jsonschema", schema)
        return self._writer.register_channel(f"/{vehicle}/{topic}", "json", self._schemas[topic])


def json_schema(kind: type[Struct]) -> dict[str, Any]:
    """JSON Schema whose top level is an object, as MCAP readers expect it."""
    schema = msgspec.json.schema(kind)
    definitions = schema.pop("$defs")
    top = definitions.pop(kind.__name__)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **top, "$defs": definitions}
