"""Reference bodies tell a frame that moved from a body that was moved."""

import math

import numpy as np
import pytest

from testbed.config import find, load
from testbed.core.codes import FaultId
from testbed.core.types import PoseSample
from testbed.flight.frame_watch import FrameWatch
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

PLACES = {"north": (0.0, 2.9, 0.0), "east": (2.9, 0.0, 0.0)}
NOISE = 2e-4  # [m]
FIXED = "table.lab.mocap.reference={north=[0.0,2.9,0.0],east=[2.9,0.0,0.0]}"


def watched(looks=20, **moved):
    """The reason after some looks; `moved` is by how much each body is off: x, y, turn."""
    watch, rng = FrameWatch(PLACES, NOISE), np.random.default_rng(0)
    for _ in range(looks):
        seen = {}
        for name, place in PLACES.items():
            off = np.array(moved.get(name, (0.0, 0.0, 0.0)))
            x, y, theta = (place + off + NOISE * rng.standard_normal(3)).tolist()
            seen[name] = PoseSample(0.0, x, y, theta)
        watch.look(seen)
    return watch


def test_bodies_in_their_place_are_fine():
    watch = watched(looks=2000)
    assert (watch.reason, watch.fault) == ("", None)


def test_a_body_that_the_cameras_do_not_see():
    assert watched().unseen == ""
    watch = FrameWatch(PLACES, NOISE)
    watch.look({"north": PoseSample(0.0, *PLACES["north"])})
    assert watch.unseen == "the cameras do not see the reference body east"


def test_a_frame_that_moved():
    watch = watched(north=(0.01, 0.0, 0.0), east=(0.01, 0.0, 0.0))
    assert "frame moved: north 10 mm, east 10 mm" in watch.reason
    assert watch.fault.id == FaultId.FRAME_MOVED


def test_a_frame_that_turned():
    turn = math.radians(1.0)
    off = 2.9 * turn
    assert "turned by 1.0 deg" in watched(north=(-off, 0.0, turn), east=(0.0, off, turn)).reason


@pytest.mark.parametrize(
    "east",
    [(0.0, -0.06, 0.0), (0.004, 0.0, 0.1)],  # y axis up; turned about a place near this body
)
def test_a_frame_that_moves_one_body_farther_than_the_other(east):
    watch = watched(north=(0.0, -2.7, 0.0), east=east)
    assert "frame moved: north 2700 mm" in watch.reason


def test_a_body_that_was_moved_alone():
    assert watched(north=(0.05, 0.0, 0.0)).reason == "reference body moved: north 50 mm off"


@pytest.mark.parametrize(("at_s", "armed"), [(0.0, False), (2.0, True)])
def test_a_frame_that_creeps_is_red_before_and_stops_in_flight(at_s, armed):
    inject = f'inject=[{{kind="creep_frame",vehicle="sat1",at_s={at_s},value=0.02}}]'
    if not armed:
        inject = inject.replace("creep_frame", "shift_frame")
    rig = make_twin(load(find("hold"), [FIXED, inject, "duration_s=6"]))
    ending = rig.fly(NullObserver())
    assert bool(rig.red) != armed
    if armed:
        assert ending.fault.origin.id == FaultId.FRAME_MOVED
        assert 2.2 < ending.t < 5.0
    else:
        assert any("frame moved" in red.reason for red in rig.red)


def flown(name, inject, *overrides):
    """How a flight ends in which the cameras show something else from 2.03 s on."""
    inject = f'inject=[{{vehicle="sat1",at_s=2.03,{inject}}}]'
    rig = make_twin(load(find(name), [inject, "duration_s=6", "seed=3", *overrides]))
    return rig.fly(NullObserver()).fault


FRAMES = [
    ('kind="shift_frame",value=0.3,towards_deg=70.0', "all by 300 mm"),
    ('kind="shift_frame",value=0.02,towards_deg=70.0', "all by 20 mm"),
    ('kind="turn_frame",value=1.2', "by a turn of 1.2 deg"),
    ('kind="turn_frame",value=-25.0', "by a turn of -25.0 deg"),
    ('kind="scale_frame",value=1000.0', "times as far from the origin"),
    ('kind="scale_frame",value=0.9', "times as far from the origin"),
    ('kind="tip_frame"', "vehicles are seen elsewhere at once"),
    ('kind="creep_frame",value=0.09', "vehicles are seen elsewhere at once"),
]


@pytest.mark.parametrize(("inject", "words"), FRAMES)
def test_a_frame_that_moves_is_no_fault_of_one_of_several_vehicles(inject, words):
    fault = flown("zhang2023_table", inject)
    assert (fault.id, fault.vehicle) == (FaultId.FRAME_MOVED, "")
    assert words in fault.text
    assert fault.notes  # what the vehicles said


@pytest.mark.parametrize("inject", [inject for inject, _ in FRAMES[:-1]])
def test_reference_bodies_name_the_frame_also_of_one_vehicle(inject):
    fault = flown("hold", inject, FIXED, "vehicles.sat1.start=[-0.5,-0.5,0.0]")
    assert (fault.id, fault.vehicle) == (FaultId.FRAME_MOVED, "")
    assert fault.text.startswith("the cameras' frame moved: north")


@pytest.mark.parametrize(
    ("inject", "name"),
    [
        ('kind="jump_mocap",value=0.3', "pose_jumped"),
        ('kind="jump_mocap",value=0.03', "frame_shifted"),
        ('kind="turn_body",value=4.0', "heading_shifted"),
        ('kind="swap_bodies",other="sat2"', "pose_swapped"),
        ('kind="noisy_mocap"', "estimator_inconsistent"),
    ],
)
def test_what_one_of_several_vehicles_shows_is_its_own_fault(inject, name):
    assert flown("zhang2023_table", inject).id == name
