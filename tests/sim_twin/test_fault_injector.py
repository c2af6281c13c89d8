"""Injected faults do to the twin what they say, and nothing before their time."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from sim_twin.board import last_closing
from sim_twin.fault_injection import FaultInjector
from testbed.core.fault_injection import Injection
from testbed.core.landing import GRAVITY
from testbed.core.table import Obstacle
from testbed.core.types import ALL_WELL, PoseSample
from testbed.core.vehicle import Landing

AT_REST = [[0.0] * 6]


@pytest.fixture
def plant(make_plant, make_vehicle):
    return make_plant([make_vehicle()], AT_REST)


def injector(plant, *injections, obstacles=None):
    return FaultInjector(injections, plant, obstacles or {}, (3.0, 3.0), seed=0)


def fault(kind, at_s=1.0, **more):
    return Injection(kind, "0", at_s=at_s, **more)


def advance(plant, broken, until, step=0.1):
    while plant.t < until - 1e-9:
        broken.before(plant.t + step)
        plant.advance(plant.t + step)
        broken.look(plant.t)


def test_a_valve_that_is_stuck_open_pushes_from_that_instant(plant, make_vehicle):
    vehicle, broken = make_vehicle(), injector(plant, fault("stick_open", 1.03, jet=1))
    advance(plant, broken, 1.0)
    assert not plant.x.any()
    advance(plant, broken, 2.0)
    valve = vehicle.valve
    flows = 2.0 - 1.03 - valve.open_delay_s - 0.5 * valve.open_ramp_s
    assert plant.impulse[0] == pytest.approx(0.6 * flows, rel=1e-9)


def test_a_valve_that_is_stuck_shut_plays_nothing(plant, make_plan):
    broken = injector(plant, fault("stick_closed", 0.05, jet=1))
    for k in range(3):
        plant.boards["0"].apply(make_plan(0.1 * k, {0: (0.0, 0.1), 4: (0.0, 0.1)}))
        broken.before(0.1 * (k + 1))
        plant.advance(0.1 * (k + 1))
    assert plant.x[0, 3] > 0.0  # jet 5 pushes on, jet 1 against it for the first 50 ms only
    one_jet, both = 0.6 * 0.3, 0.6 * 0.05
    assert plant.impulse[0] == pytest.approx(one_jet + both, abs=0.6 * 0.02)


def test_a_stuck_valve_may_come_free(plant):
    broken = injector(plant, fault("stick_open", 1.0, jet=1, for_s=0.5))
    advance(plant, broken, 3.0)
    assert plant.impulse[0] == pytest.approx(0.6 * 0.5, rel=1e-9)


def test_a_valve_that_leaks_pushes_a_share_and_open_no_more_than_whole(plant, make_plan):
    broken = injector(plant, fault("leak_valve", 1.0, value=0.3, jet=1))
    advance(plant, broken, 1.0)
    assert not plant.x.any()
    advance(plant, broken, 2.0)
    opens = 0.006 + 0.5 * 0.002  # as long as any other valve
    assert plant.impulse[0] == pytest.approx(0.6 * 0.3 * (1.0 - opens), rel=1e-6)
    before = plant.impulse[0]
    plant.boards["0"].apply(make_plan(2.0, {0: (0.0, 0.1)}))
    advance(plant, broken, 2.5)
    assert plant.impulse[0] - before == pytest.approx(0.6 * (0.1 + 0.3 * 0.4), rel=1e-6)


@pytest.mark.parametrize("share", [0.7, 0.4])
def test_a_jet_that_is_held_open_gets_weak_at_that_instant(plant, make_plan, share):
    broken = injector(plant, fault("weak_jet", 1.04, value=share, jet=1))
    pushed = []
    for k in range(20):
        plant.boards["0"].apply(make_plan(0.1 * k, {0: (0.0, 0.1)}))
        advance(plant, broken, 0.1 * (k + 1))
        pushed.append(plant.impulse[0])
    assert np.diff(pushed)[:9] == pytest.approx(0.06, rel=1e-6)  # open from the start
    assert pushed[10] - pushed[9] == pytest.approx(0.06 * (0.4 + 0.6 * share), abs=0.6 * 0.008)
    assert np.diff(pushed)[10:] == pytest.approx(0.06 * share, rel=1e-6)


def test_a_valve_that_begins_to_leak_while_open_pushes_no_more_than_whole(plant, make_plan):
    broken = injector(plant, fault("leak_valve", 1.04, value=0.3, jet=1))
    pushed = []
    for k in range(20):
        if k < 15:
            plant.boards["0"].apply(make_plan(0.1 * k, {0: (0.0, 0.1)}))
        advance(plant, broken, 0.1 * (k + 1))
        pushed.append(plant.impulse[0])
    assert np.diff(pushed)[:14] == pytest.approx(0.06, rel=1e-6)
    assert np.diff(pushed)[16:] == pytest.approx(0.06 * 0.3, rel=1e-6)


def test_a_leak_takes_gas(plant):
    broken = injector(plant, fault("leak", 1.05, value=0.01, for_s=2.0))
    advance(plant, broken, 1.0)
    assert plant.used[0] == 0.0
    advance(plant, broken, 5.0)
    assert plant.used[0] == pytest.approx(0.02)


@pytest.mark.parametrize("friction", [0.05, 0.1, 0.2])
def test_a_vehicle_without_air_stands(make_plant, make_vehicle, friction):
    vehicle = replace(make_vehicle(), landing=Landing(friction=friction))
    plant = make_plant([vehicle], [[0.0, 0.0, 0.0, 0.1, 0.0, 0.5]])
    plant.stick(0, 0, True, 0.0, 10.0)
    assert plant.floats(0)
    plant.land(0)
    plant.advance(1.0)
    assert not plant.floats(0)
    assert plant.x[0, 3:].tolist() == [0.0, 0.0, 0.0]
    assert plant.x[0, 0] == pytest.approx(0.1**2 / (2.0 * friction * GRAVITY), rel=1e-9)
    assert plant.impulse[0] == 0.0
    assert plant.stands


def drifting(make_plant, make_vehicle, **landing):
    vehicle = replace(make_vehicle(), landing=Landing(**landing))
    return make_plant([vehicle], [[0.0, 0.0, 0.0, 0.1, 0.0, 0.0]])


def test_the_board_of_a_dead_process_lands_the_vehicle(make_plant, make_vehicle):
    """At 0.1 m/s: 0.15 s to the watchdog, 0.1 s of the file's room, and a window of the plant."""
    landing = {"speed": 0.1, "slope": 0.0, "room": 0.1 * 0.25 + 0.1**2 / (2.0 * 0.1 * GRAVITY)}
    plant = drifting(make_plant, make_vehicle, **landing)
    advance(plant, injector(plant, fault("kill_process", 1.0)), 1.2)
    assert plant.floats(0)
    advance(plant, injector(plant, fault("kill_process", 1.0)), 3.0)
    assert plant.landed[0] == pytest.approx(1.3)
    assert plant.stands
    assert plant.x[0, 0] == pytest.approx(0.13 + 0.1**2 / (2.0 * 0.1 * GRAVITY), rel=1e-9)


def test_it_keeps_the_air_on_if_its_file_says_so_or_the_process_is_back_in_time(
    make_plant, make_vehicle
):
    plant = drifting(make_plant, make_vehicle, by_board=False)
    advance(plant, injector(plant, fault("kill_process", 1.0)), 3.0)
    assert plant.floats(0)
    plant = drifting(make_plant, make_vehicle)
    advance(plant, injector(plant, fault("kill_process", 1.0, for_s=0.149)), 3.0)
    assert plant.floats(0)


def test_what_stands_does_not_slide_down_the_slope(make_plant, make_vehicle, make_table):
    table = make_table(tilt={"uniform": (0.002, 0.0)})
    plant = make_plant([make_vehicle()], [[0.0] * 6], table=table)
    plant.land(0)
    plant.advance(60.0)
    assert plant.x[0].tolist() == [0.0] * 6
    assert plant.landed == {0: 0.0}


def test_a_board_without_power_shuts_its_valves_and_hears_nothing(plant, make_plan):
    board, broken = plant.boards["0"], injector(plant, fault("brown_out", 0.05, for_s=0.2))
    board.apply(make_plan(0.0, {0: (0.0, 0.1)}))
    broken.before(0.1)
    assert last_closing(board.pulses) == pytest.approx(0.05)
    board.apply(make_plan(0.1, {0: (0.0, 0.1)}))
    assert last_closing(board.pulses) == pytest.approx(0.05)
    broken.look(0.1)
    assert broken.power("0", 12.0) == (7.0, pytest.approx(0.05))
    board.apply(make_plan(0.3, {0: (0.0, 0.1)}))  # it has its power back, and is SAFE
    assert last_closing(board.pulses) == pytest.approx(0.05)
    broken.look(0.3)
    assert broken.power("0", 12.0) == (12.0, pytest.approx(0.25))


SEEN = [PoseSample(t, 0.1 * t, 0.0, 0.0) for t in (0.9, 1.0, 1.1)]


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("drop_mocap", SEEN[:1]),
        (
            "freeze_mocap",
            [SEEN[0], *(PoseSample(s.captured_at, SEEN[0].x, 0.0, 0.0) for s in SEEN[1:])],
        ),
        (
            "jump_mocap",
            [SEEN[0], *(PoseSample(s.captured_at, s.x + 0.3, 0.0, 0.0) for s in SEEN[1:])],
        ),
        ("leak", SEEN),
    ],
)
def test_cameras_fail_with_the_first_frame_after_it(kind, expected, plant):
    broken = injector(plant, fault(kind))
    broken.look(1.2)
    assert broken.poses("0", SEEN) == expected
    assert broken.poses("another", SEEN) == SEEN


def test_noise_is_drawn_from_the_seed(plant):
    looks = [injector(plant, fault("noisy_mocap")).poses("0", SEEN) for _ in range(2)]
    assert looks[0] == looks[1]
    assert looks[0][0] == SEEN[0]
    assert looks[0][1] != SEEN[1]


def test_a_step_of_the_clock_moves_the_stamps(plant):
    broken = injector(plant, fault("clock_step", value=0.2))
    broken.look(1.2)
    assert [s.captured_at for s in broken.poses("0", SEEN)] == pytest.approx([0.7, 0.8, 0.9])
    assert broken.vitals("0").clock_offset == 0.2


def test_bodies_are_swapped_frame_by_frame(make_plant, make_vehicle):
    plant = make_plant([make_vehicle()] * 2, [[0.0] * 6, [1.0] + [0.0] * 5])
    broken = injector(plant, fault("swap_bodies", 1.0, other="1", for_s=0.5))
    rows = broken.sources(["0", "1"], np.array([0.9, 1.0, 1.4, 1.5]))
    assert rows == [[0, 1], [1, 0], [1, 0], [0, 1]]
    assert broken.sources(["0", "1"], np.array([0.5])) is None


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("operator_gone", {"operator_age": pytest.approx(0.5)}), ("overrun", {"late_s": 0.08}),
        ("disk_full", {"disk_free": 0.0}), ("config_differs", {"same_config": False}),
    ],
)  # fmt: skip
def test_faults_of_the_vitals_begin_and_end(kind, says, plant):
    broken = injector(plant, fault(kind, for_s=1.0))
    assert broken.vitals("0") == ALL_WELL
    broken.look(1.5)
    assert {name: getattr(broken.vitals("0"), name) for name in says} == says
    broken.look(2.0)
    assert broken.vitals("0") == ALL_WELL


def test_what_befalls_law_process_and_link(plant):
    for kind, before, after in (
        ("nan_law", "", "nan"), ("raise_law", "", "raise"),
    ):  # fmt: skip
        broken = injector(plant, fault(kind))
        assert broken.spoilt("0") == before
        broken.look(1.0)
        assert broken.spoilt("0") == after
    broken = injector(plant, fault("kill_process"), fault("delay_link"), fault("lose_link"))
    assert not broken.dead("0")
    assert broken.radio("0") == (0.0, 0.0)
    broken.look(1.0)
    assert broken.dead("0")
    assert broken.radio("0") == (0.6, 1.0)


@pytest.mark.parametrize(
    ("event", "threshold", "place"),
    [
        ("near_obstacle", 0.5, [1.6, 0.0]), ("near_edge", 0.2, [0.0, -2.9]),
        ("faster_than", 0.1, [0.0, 0.0]),
    ],
)  # fmt: skip
def test_an_event_begins_a_fault(event, threshold, place, plant):
    obstacles = {"o": Obstacle((2.0, 0.0), 0.8)}
    what = Injection("drop_mocap", "0", event=event, threshold=threshold)
    broken = injector(plant, what, obstacles=obstacles)
    broken.look(1.0)
    assert broken.began() == [math.inf]
    plant.x[0, :2] = place
    plant.x[0, 3] = 0.2 if event == "faster_than" else 0.0
    broken.look(2.0)
    broken.look(3.0)
    assert broken.began() == [2.0]


def test_two_that_meet_begin_a_fault(make_plant, make_vehicle):
    plant = make_plant([make_vehicle()] * 2, [[0.0] * 6, [1.0] + [0.0] * 5])
    what = Injection("drop_mocap", "0", event="near_vehicle", threshold=0.8)
    broken = injector(plant, what)
    broken.look(1.0)
    assert broken.began() == [math.inf]
    plant.x[1, 0] = 0.7
    broken.look(2.0)
    assert broken.began() == [2.0]


def seen(broken, name, t, x=1.0, y=0.5, theta=0.1):
    """The pose that the cameras show at this time of a body that does not move."""
    broken.look(t)
    (one,) = broken.poses(name, [PoseSample(t, x, y, theta)]) or [None]
    return None if one is None else (one.captured_at, one.x, one.y, one.theta)


@pytest.mark.parametrize(
    ("kind", "value", "shown"),
    [
        ("turn_body", 180.0, (1.0, 0.5, 0.1 - math.pi)),
        ("shift_frame", 0.05, (1.05, 0.5, 0.1)),
        ("creep_frame", 0.01, (1.02, 0.5, 0.1)),  # two seconds after it began
        ("turn_frame", 90.0, (-0.5, 1.0, 0.1 + 0.5 * math.pi)),
        ("scale_frame", 1000.0, (1000.0, 500.0, 0.1)),
        ("tip_frame", None, (1.0, 0.2, 0.0)),
    ],
)
def test_cameras_with_another_frame_show_another_pose(plant, kind, value, shown):
    broken = injector(plant, fault(kind, 1.0, value=value))
    assert seen(broken, "0", 0.9) == (0.9, 1.0, 0.5, 0.1)
    t, *pose = seen(broken, "0", 3.0)
    assert t == 3.0
    assert pose == pytest.approx(shown)


def test_a_frame_that_is_wrong_is_wrong_for_every_body(make_plant, make_vehicle):
    two = make_plant([make_vehicle(), make_vehicle()], [[0.0] * 6, [1.0] + [0.0] * 5])
    assert seen(injector(two, fault("shift_frame", 1.0)), "1", 2.0)[1] == 1.05
    assert seen(injector(two, fault("turn_body", 1.0)), "1", 2.0)[3] == 0.1


def test_old_poses_have_fresh_stamps(plant):
    broken = injector(plant, fault("delay_mocap", 1.0, value=0.25))
    shown = [seen(broken, "0", 0.125 * k, x=float(k)) for k in range(21)]
    assert [one[0] for one in shown] == [0.125 * k for k in range(21)]
    assert [one[1] for one in shown] == [*range(8), *range(6, 19)]


def test_slow_cameras_show_a_part_of_the_frames(plant):
    broken = injector(plant, fault("slow_mocap", 1.0, value=4.0))
    there = [seen(broken, "0", 0.01 * k) is not None for k in range(300)]
    assert all(there[:100])
    assert sum(there[100:]) == 8  # in two seconds


def test_a_frozen_pose_may_have_noise(plant):
    broken = injector(plant, fault("freeze_mocap", 1.0, value=1e-6))
    seen(broken, "0", 0.9)
    _, x, y, theta = seen(broken, "0", 2.0, x=2.0)
    assert (x, y, theta) == pytest.approx((1.0, 0.5, 0.1), abs=1e-4)
    assert x != 1.0
    assert theta != 0.1


@pytest.mark.parametrize(
    ("kind", "more", "forces"),
    [
        ("thrust", {"value": 0.6}, {0: 0.6, 1: 0.6}),
        ("regulator", {"value": 1.5}, {0: 1.5, 1: 1.5}),
        ("reverse_jet", {"jet": 1}, {0: -1.0, 1: 1.0}),
    ],
)
def test_a_jet_gives_what_the_fault_leaves_it_and_then_all(plant, kind, more, forces):
    drawn, broken = plant.parameters.effect.copy(), injector(plant, fault(kind, for_s=1.0, **more))
    for t, shares in ((0.9, {}), (1.5, forces), (2.5, {})):
        advance(plant, broken, t)
        broken.before(t + 0.1)
        for jet in range(2):
            wanted = shares.get(jet, 1.0) * drawn[0, :, jet]
            assert plant.parameters.effect[0, :, jet] == pytest.approx(wanted)


def test_a_fault_that_ends_on_a_vehicle_without_air_gives_it_none(plant):
    broken = injector(plant, fault("thrust", for_s=0.5))
    advance(plant, broken, 1.2)
    plant.land(0)
    advance(plant, broken, 2.0)
    assert not plant.parameters.effect.any()
    plant.lift(0)
    broken.before(2.1)
    assert plant.parameters.thrust[0, 0] == pytest.approx(0.6)


def test_swapped_wires_open_the_other_valve(plant):
    drawn, broken = plant.parameters.effect[0].copy(), injector(plant, fault("swap_jets", value=3))
    advance(plant, broken, 1.5)
    assert plant.parameters.effect[0, :, 0] == pytest.approx(drawn[:, 2])
    assert plant.parameters.effect[0, :, 2] == pytest.approx(drawn[:, 0])


def test_swapped_boards_push_the_other_vehicle(make_plant, make_vehicle, make_plan):
    two = make_plant([make_vehicle(), make_vehicle()], [[0.0] * 6, [1.0] + [0.0] * 5])
    broken = injector(two, fault("swap_boards", 0.0, other="1"))
    two.boards["0"].apply(make_plan(0.0, {0: (0.0, 0.1)}))
    advance(two, broken, 0.3)
    assert two.impulse[0] == 0.0
    assert two.impulse[1] > 0.0


def test_a_hose_pulls_and_a_pad_brakes(plant):
    broken = injector(plant, fault("hose", 0.95, value=0.1), fault("pad_drag", 0.95))
    advance(plant, broken, 1.0)
    assert not plant.x.any()
    advance(plant, broken, 2.0)
    mass = plant.parameters.mass[0]
    free = 0.1 / mass  # [m/s] after a second without the pad
    assert plant.x[0, 3] == pytest.approx(0.1 / 2.0 * (1.0 - math.exp(-2.0 / mass)), rel=1e-3)
    assert plant.x[0, 3] < free


def test_what_the_board_reads(plant):
    broken = injector(plant, fault("sag", value=0.5), fault("flat_battery", 2.0, value=9.0))
    readings = []
    for t in (0.5, 1.5, 2.5):
        broken.look(t)
        readings.append((broken.supply("0", 5e5), broken.power("0", 12.0)[0]))
    assert readings == [(5e5, 12.0), (2.5e5, 12.0), (2.5e5, 9.0)]


def test_an_empty_tank_reads_nothing(plant):
    broken = injector(plant, fault("empty_tank"))
    advance(plant, broken, 1.5)
    assert broken.supply("0", 5e5) == 0.0
    assert plant.used[0] == plant.parameters.gas[0]
