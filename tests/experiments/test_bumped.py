"""A jump of the velocity that no command explains: a contact, or a hand."""

import math

import pytest

from testbed.config import find, load
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

AT = 5.0  # [s]
METRE = ["vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]"]


class Hand(NullObserver):
    """Makes the vehicle's velocity jump."""

    ticks = None  # the twin must not be ahead of the hand

    def __init__(self, push):
        self.push, self.rig, self.first = push, None, None
        self.rows = set()

    def vehicle(self, name, tick):
        self.rows |= set(tick.outputs.faults)
        if tick.outputs.fault is not None and self.first is None:
            self.first = tick.inputs.t

    def done(self, t):
        if self.push and t >= AT:
            self.rig.twin.plant.x[0, 3:5] += self.push
            self.push = None


def pushed(push, *words):
    hand = Hand(push)
    words = ["duration_s=12", "vehicles.sat1.goal=[0.0,-0.1,0.0]", *words]
    hand.rig = make_twin(load(find("hold"), words))
    return hand.rig.fly(hand), hand.first


@pytest.mark.parametrize("rate", [50.0, 100.0, 240.0])
@pytest.mark.parametrize("push", [(0.1, 0.0), (-0.08, 0.12)])
def test_a_jump_of_the_velocity_stops_the_flight(push, rate):
    ending, first = pushed(push, f"table.mocap.rate_hz={rate}")
    assert ending.fault.id == "bumped"
    said = float(ending.fault.text.split()[3])
    assert 0.7 < said / math.hypot(*push) < 1.3
    assert "no known body is near" in ending.fault.text
    assert first - AT < 0.4


def test_a_contact_says_with_what():
    obstacle = "obstacles.post={position=[0.4,-0.1],radius=0.35,solid=0.2}"
    ending, _ = pushed((-0.1, 0.0), obstacle, "flight.barrier.on=false")
    assert ending.fault.id == "bumped"
    assert "contact with post" in ending.fault.text


@pytest.mark.parametrize("push", [(0.02, 0.0), (-0.012, 0.015)])
def test_a_nudge_is_named_and_no_wrong_thrust_or_jet(push):
    hand = Hand(push)
    hand.rig = make_twin(load(find("hold"), ["duration_s=15", *METRE]))
    assert hand.rig.fly(hand).fault is None
    assert hand.rows == {"nudged"}


@pytest.mark.parametrize("push", [(0.0, 0.0), (0.004, 0.0)])
def test_a_light_touch_is_no_contact(push):
    ending, _ = pushed(push)
    assert ending.fault is None
