"""Hints at the name that was meant."""

import pytest

from testbed.core.spelling import did_you_mean


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("sat3", " (did you mean `sat1`?)"),
        ("x_mm", " (did you mean `x_m`?)"),
        ("zhang", " (did you mean `zhang2023`?)"),
        ("q", ""),
    ],
)
def test_only_a_name_that_is_nearly_right_gets_a_hint(name, hint):
    assert did_you_mean(name, ["t_s", "x_m", "sat1", "zhang2023"]) == hint
