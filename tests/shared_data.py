"""The labs' logs, where they are on this machine; nothing of them is in the project."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def shared(name: str) -> Path:
    """A file of the labs' data, or a skip."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"the labs' data are not on this machine: {path}")
    return path
