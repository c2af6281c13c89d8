"""Reads a table file by name or path, and writes one."""

from datetime import date
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from testbed.config.tree import read_toml
from testbed.core.error import TestbedError
from testbed.core.table import Table
from testbed.identification.mapping import convert, named_file

LEVEL_TABLE: dict[str, Any] = {  # where no table file is given
    "size": [6.0, 6.0], "restitution": 0.4, "tilt": {"uniform": [0.0, 0.0]},
    "mocap": {"rate_hz": 100.0, "latency_s": 0.02, "jitter_s": 0.001, "noise": 0.0002,
              "noise_deg": 0.03, "dropout_rate": 0.0, "dropout_s": 0.05},
    "link": {"delay_s": 0.005, "jitter_s": 0.003, "loss": 0.0, "burst_loss": 0.0,
             "burst_enter": 0.0, "burst_leave": 1.0},
}  # fmt: skip


def load_table(name: str | None) -> Table:
    """A table given as a file or as the name of a shipped one; None: a level one."""
    if name is None:
        return msgspec.convert(LEVEL_TABLE, Table)
    path = named_file(name, "tables", "a table file")
    table: Table = convert(read_toml(path), Table, path)  # type: ignore[assignment]
    return table


def write_table(path: Path, table: Table, origin: list[str], day: date) -> None:
    """Write a table file; `origin` says at its top where the numbers come from."""
    tree = {k: v for k, v in msgspec.to_builtins(table).items() if v is not None and k != "lab"}
    tree["link"] = {k: v for k, v in tree["link"].items() if v is not None}
    head = [f"# Calibrated on {day.isoformat()} with `testbed calibrate`. From:"]
    text = "\n".join([*head, *(f"#   {line}" for line in origin), "", tomli_w.dumps(tree)])
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise TestbedError(
            where=str(path), expected="a writable path", found=error.strerror or str(error)
        ) from None
