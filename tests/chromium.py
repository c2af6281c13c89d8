"""Chromium for tests that look at a page."""

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest

DRIVER = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "browser.py"


def chromium() -> ModuleType:
    """The module that drives Chromium; skips without Chromium, which CI must have."""
    spec = importlib.util.spec_from_file_location("chromium_driver", DRIVER)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    if loaded.find() is None:
        assert not os.environ.get("CI"), "Chromium is not installed"
        pytest.skip("Chromium is not installed")
    return loaded
