"""A log as a lab writes it: MCAP with messages in JSON."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mcap.writer import Writer


def write_mcap(path: Path, topic: str, rows: Iterable[tuple[float, Mapping[str, Any]]]) -> None:
    """Write rows, each a time [s] and a message, to a file of one topic."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Row", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel(topic, "json", schema)
        for t, message in rows:
            stamp = round(1e9 * t)
            writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()
