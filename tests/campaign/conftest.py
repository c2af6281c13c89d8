"""Campaign files to spoil, and a crew that flies nothing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from pretence import hold, no_warm_up, pretend, pretend_with_log

from testbed.campaign.flight import RunFunctions


@pytest.fixture
def fliers() -> Callable[[int], RunFunctions]:
    return lambda jobs=1: RunFunctions(pretend, pretend_with_log, no_warm_up, hold, jobs)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a campaign file."""

    def write_file(file: str = "campaign.toml", **keys: Any) -> Path:
        tree = {"name": "try", "experiment": "hold", **keys}
        path = tmp_path / file
        path.write_text(tomli_w.dumps(tree), encoding="utf-8")
        return path

    return write_file
