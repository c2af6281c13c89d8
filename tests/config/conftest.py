"""Experiment files to spoil."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from testbed.config import dump, find, load


@pytest.fixture
def tree() -> dict[str, Any]:
    """zhang2023's experiment with everything in place, as a tree that a test may change."""
    return dump(load(find("zhang2023_table")))


@pytest.fixture
def write(tmp_path: Path) -> Callable[[dict[str, Any]], Path]:
    """Write a tree as an experiment file."""

    def write_tree(tree: dict[str, Any]) -> Path:
        path = tmp_path / "experiment.toml"
        path.write_text(tomli_w.dumps(tree), encoding="utf-8")
        return path

    return write_tree
