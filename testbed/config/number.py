"""Validates the range of all numbers."""

import math
from collections.abc import Iterator
from typing import Any

from testbed.config.error import Violation, show
from testbed.config.tree import leaves

LARGEST = 1e9  # in SI units: 10 000 bar, 30 years


def bad_numbers(tree: dict[str, Any]) -> Iterator[Violation]:
    """Numbers that are not finite, or implausibly large."""
    for key, value in leaves(tree):
        if isinstance(value, float) and not math.isfinite(value):
            yield Violation(key, "a finite number", show(value))
        elif isinstance(value, int | float) and abs(value) > LARGEST and key != ("seed",):
            yield Violation(key, f"a number of at most {LARGEST:g}", show(value))
