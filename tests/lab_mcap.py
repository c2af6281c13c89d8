"""A log as a lab writes it: MCAP with messages in JSON."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mcap.writer import Writer


def write_mcap(
    path: Path, topics: Sequence[str], rows: Iterable[tuple[float, Mapping[str, Any]]]
) -> None:
    """Write rows, each a time [s] and a message, to a file, once for each topic."""
    kept = list(rows)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Row", "jsonschema", b'{"type": "object"}')
        for topic in topics:
            channel = writer.register_channel(topic, "json", schema)
            for t, message in kept:
                stamp = round(1e9 * t)
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()
