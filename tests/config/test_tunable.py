"""Parameters of a law that may change in flight, and their bounds."""

import pytest

from testbed.config import ConfigError, find, load
from testbed.config.tunable import retuned, tunables

LAW = """
from typing import Annotated

import numpy as np
from msgspec import Meta


class Mine:
    def __init__(self, stiffness: Annotated[float, Meta(gt=0.0, le=2.0)] = 0.5, on: bool = True):
        self.stiffness = stiffness

    def force(self, own, neighbours, world, t):
        return self.stiffness * (world.goal.p - own.p)
"""


def hold(*overrides):
    return load(find("hold"), overrides)


def test_real_numbers_of_a_law_have_their_bounds():
    found = {one.name: one for one in tunables(hold().controller)}
    assert list(found) == ["bandwidth", "damping"]  # the scale is not a gain
    assert (found["damping"].value, found["damping"].low, found["damping"].open_low) == (1, 0, True)


def test_parts_of_a_law_are_named_with_dots():
    names = {one.name for one in tunables(load(find("zhang2023_table"), []).controller)}
    assert {"lambda", "potential.standoff"} <= names  # as in the file, not as in Python


def test_another_value_makes_another_law_and_nothing_else():
    before = hold()
    after = retuned(before, {"bandwidth": 0.4})
    assert after.controller.bandwidth == 0.4
    assert after.controller.damping == before.controller.damping
    assert after.flight == before.flight


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("bandwidth", -1.0, "bandwidth > 0"),
        ("bandwidth", 0.0, "bandwidth > 0"),
        ("bandwidth", float("nan"), "a finite number"),
        ("bandwidth", float("inf"), "a finite number"),
        ("speed", 1.0, "one of: bandwidth, damping"),
        ("scale.length", 2.0, "one of: bandwidth, damping"),
    ],
)
def test_a_wrong_value_is_refused_with_its_bounds(name, value, words):
    with pytest.raises(ConfigError, match=words):
        retuned(hold(), {name: value})


def test_a_users_law_has_the_bounds_of_its_annotations(tmp_path):
    (tmp_path / "law.py").write_text(LAW)
    before = hold(f'controller={{type="python",law="{tmp_path}/law.py:Mine"}}', "criteria={}")
    (one,) = tunables(before.controller)
    assert (one.name, one.value, one.low, one.high) == ("parameters.stiffness", 0.5, 0.0, 2.0)
    after = retuned(before, {"parameters.stiffness": 2.0})
    assert after.controller.parameters == {"stiffness": 2.0}
    with pytest.raises(ConfigError, match=r"parameters.stiffness > 0 and <= 2"):
        retuned(before, {"parameters.stiffness": 2.5})
