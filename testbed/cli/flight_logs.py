"""Which logs of flights a verb reads, as given at the command line."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class FlightLogs(NamedTuple):
    """Logs or run folders, and the part of their time that is used."""

    paths: Sequence[Path]
    mapping: str | None  # mapping file, or name of a shipped one; None: run folders
    body: str | None  # the vehicle in a run folder
    since: float | None  # [s]
    until: float | None  # [s]
