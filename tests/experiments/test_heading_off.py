"""A heading that was off from the start: the words say which way, for whoever corrects it."""

import re

import pytest

from testbed.config import find, load
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin


@pytest.mark.parametrize("off", [15.0, -15.0])
def test_the_words_have_the_sign_of_the_error(off):
    turned = f'inject=[{{kind="turn_body", vehicle="sat1", at_s=0.0, for_s=100.0, value={off}}}]'
    way = ["vehicles.sat1.start=[-1.0,-1.0,0.0]", "vehicles.sat1.goal=[1.0,1.0,1.0]"]
    words = ['vehicles.sat1.model="freeflyer"', "duration_s=40", *way, turned]
    # without the arming checks, which would find it
    ending = make_twin(load(find("hold"), words)).fly_unasked(NullObserver(), lambda: 0)
    assert ending.fault.id == "heading_off"
    said = float(re.search(r"off by (-?\d+) deg", ending.fault.text)[1])
    assert said == pytest.approx(off, abs=5.0)
