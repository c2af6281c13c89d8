"""Checks the arguments of a script's calls: a wrong one is named with what was expected."""

import math
import os
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from testbed.config import Experiment
from testbed.config.shipped import shipped
from testbed.core.error import TestbedError


def check_experiment(where: str, value: object) -> None:
    """Refuse what is not an experiment.

    Raises:
        TestbedError: for instance, the name of an experiment.
    """
    if isinstance(value, Experiment):
        return
    hint = ""
    if isinstance(value, str):  # a scenario is loaded by the path of its file
        names, scenarios = shipped("experiments"), shipped("scenarios")
        by_path = value in scenarios and value not in names
        hint = f"testbed.load({str(scenarios[value]) if by_path else value!r})"
    raise wrong(where, "an experiment, from testbed.load", value, hint)


def check_overrides(where: str, overrides: Sequence[object]) -> None:
    """Refuse overrides that are not texts.

    Raises:
        TestbedError: for instance, one is a list.
    """
    for one in overrides:
        if not isinstance(one, str):
            hint = "give each as an argument of its own: *overrides"
            is_list = isinstance(one, list | tuple)
            raise wrong(where, 'overrides as texts, "key=value"', one, hint if is_list else "")


def check_number(where: str, value: object, expected: str) -> None:
    """Refuse what is not a finite number.

    Raises:
        TestbedError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise wrong(where, expected, value)


def check_count(where: str, value: object, expected: str) -> None:
    """Refuse what is not a whole number from 1.

    Raises:
        TestbedError: for instance, it is 0.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise wrong(where, expected, value)


def check_positive(where: str, value: object, expected: str) -> None:
    """Refuse what is not a finite number above zero.

    Raises:
        TestbedError: for instance, it is negative.
    """
    check_number(where, value, expected)
    if not value > 0.0:  # type: ignore[operator]  # a number, as checked
        raise wrong(where, expected, value)


def seeds_of(where: str, value: Iterable[Any]) -> list[int]:
    """The values as a list of seeds.

    Raises:
        TestbedError: it is no list, or one of them is not a whole number that a file can hold.
    """
    seeds = list_of(where, value, "a list of seeds: range(20)")
    for one in seeds:
        if isinstance(one, bool) or not isinstance(one, Integral) or not 0 <= int(one) < 2**63:
            raise wrong(where, "seeds that are whole numbers from 0 to 2^63 - 1", one)
    return [int(one) for one in seeds]


def path_of(where: str, value: object, expected: str) -> Path:
    """The value as a path.

    Raises:
        TestbedError: it is neither a text nor a path.
    """
    if not isinstance(value, str | os.PathLike):
        raise wrong(where, expected, value)
    return Path(value)


def list_of(where: str, value: Iterable[Any], expected: str) -> list[Any]:
    """The values as a list.

    Raises:
        TestbedError: it is one value and not several; a text is one value.
    """
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise wrong(where, expected, value)
    return list(value)


def wrong(where: str, expected: str, found: object, hint: str = "") -> TestbedError:
    """The error about a wrong argument."""
    return TestbedError(where=where, expected=expected, found=reprlib.repr(found), hint=hint)
