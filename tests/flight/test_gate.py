"""The gate, one row per reason and boundary: opened only when every condition holds."""

import math

import pytest
from msgspec.structs import replace

from stages import Gate
from testbed.core.codes import InhibitReason, Refusal
from testbed.core.types import Demand, Health, Pose, Twist, ValveCommand, Wrench
from testbed.flight.gate import AHEAD, EARLY, Fence, GateParams, refuse_plan

PARAMS = GateParams(
    pose_timeout_s=0.5,
    blind_s=1.5,
    link_timeout_s=2.0,
    max_rejected=30,
    max_speed=0.6,
    max_spin=1.5,
)
FENCE = Fence(2.8, 2.7)
NOW = 100.0  # [s]
SETPOINT = Demand(NOW, 0.0, 0.0, 0.0, 0.0, 0.0, valid_until=NOW + 0.5)
WRENCH = Wrench(0.1, -0.1, 0.01)
HEALTH = Health(NOW, 6e5, 20e6)
OK = None


def up(x):
    return math.nextafter(x, math.inf)


def ask(gate, state, *, armed=True, setpoint=SETPOINT, wanted=WRENCH, health=HEALTH, **options):
    return gate.refuse(NOW, armed, state, setpoint, wanted, health, **options)


@pytest.fixture
def healthy(make_state):
    return make_state(t=NOW)


@pytest.fixture
def gate():
    return Gate(PARAMS, FENCE)


def test_open_when_all_is_well(gate, healthy):
    assert ask(gate, healthy) is None
    assert gate.fault is None


# Waiting


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"armed": False}, InhibitReason.NOT_ARMED),
        ({"setpoint": None}, InhibitReason.NO_SETPOINT_YET),
    ],
)
def test_waiting_is_not_a_fault(change, reason, gate, healthy):
    assert ask(gate, healthy, **change) == Refusal(reason)
    assert gate.fault is None
    assert ask(gate, healthy) is None


def test_waiting_for_the_first_pose_is_not_a_fault(gate, healthy):
    assert ask(gate, None) == Refusal(InhibitReason.NO_POSE_YET)
    assert gate.fault is None
    assert ask(gate, healthy) is None


def test_a_disarmed_vehicle_may_stand_outside(gate, make_state):
    assert ask(gate, make_state((9.0, 0.0, 0.0)), armed=False) == Refusal(InhibitReason.NOT_ARMED)
    assert gate.fault is None


# Faults


SPEED = PARAMS.max_speed
ROWS = [
    # the estimate's age and trust
    ("age", {"pose_age": 0.0}, OK),
    ("age", {"pose_age": 0.5}, OK),
    ("age", {"pose_age": up(0.5)}, "no pose for"),
    ("age", {"pose_age": math.inf}, "no pose for"),
    ("rejected", {"rejected": 30}, OK),
    ("rejected", {"rejected": 31}, "31 poses contradict"),
    # the fence
    ("fence", {"pose": Pose(2.8, 0.0, 0.0)}, OK),
    ("fence", {"pose": Pose(-2.8, -2.7, 0.0)}, OK),
    ("fence", {"pose": Pose(up(2.8), 0.0, 0.0)}, "outside the fence"),
    ("fence", {"pose": Pose(-up(2.8), 0.0, 0.0)}, "outside the fence"),
    ("fence", {"pose": Pose(0.0, up(2.7), 0.0)}, "outside the fence"),
    ("fence", {"pose": Pose(0.0, -up(2.7), 0.0)}, "outside the fence"),
    ("fence", {"pose": Pose(9e8, 0.0, 0.0)}, "outside the fence"),
    # speed
    ("speed", {"twist": Twist(SPEED, 0.0, 0.0)}, OK),
    ("speed", {"twist": Twist(0.0, -SPEED, 0.0)}, OK),
    ("speed", {"twist": Twist(up(SPEED), 0.0, 0.0)}, "too fast"),
    ("speed", {"twist": Twist(0.0, -up(SPEED), 0.0)}, "too fast"),
    ("speed", {"twist": Twist(0.6 * SPEED, 0.79 * SPEED, 0.0)}, OK),
    ("speed", {"twist": Twist(0.6 * SPEED, 0.81 * SPEED, 0.0)}, "too fast"),
    ("spin", {"twist": Twist(0.0, 0.0, 1.5)}, OK),
    ("spin", {"twist": Twist(0.0, 0.0, -1.5)}, OK),
    ("spin", {"twist": Twist(0.0, 0.0, up(1.5))}, "too fast"),
    ("spin", {"twist": Twist(0.0, 0.0, -up(1.5))}, "too fast"),
    # numbers
    *(
        ("number", {"pose": Pose(*[bad if i == k else 0.0 for i in range(3)])}, "not a number")
        for bad in (math.nan, math.inf, -math.inf, 1e9)
        for k in range(3)
    ),
    *(
        ("number", {"twist": Twist(*[bad if i == k else 0.0 for i in range(3)])}, "not a number")
        for bad in (math.nan, math.inf, -math.inf, 1e9)
        for k in range(3)
    ),
]


def verdict(gate, reason, said):
    """Whether it said what it should, and keeps a fault for ever."""
    if reason is OK:
        return said is None and gate.fault is None
    return said is not None and reason in said.words and gate.fault == said


@pytest.mark.parametrize(("row", "change", "reason"), ROWS)
def test_a_state_beyond_a_limit_shuts_the_valves_and_says_why(row, change, reason, gate, healthy):
    assert verdict(gate, reason, ask(gate, replace(healthy, **change)))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9])
@pytest.mark.parametrize("field", ["fx", "fy", "tau"])
def test_a_wrench_that_is_not_a_number(field, bad, gate, healthy):
    said = ask(gate, healthy, wanted=replace(WRENCH, **{field: bad}))
    assert verdict(gate, "asks for something that is not a number", said)


@pytest.mark.parametrize(
    ("valid_until", "reason"),
    [
        (NOW + 0.5, OK),
        (NOW, OK),
        (NOW - 2.0, OK),  # it may wait that long at rest
        (math.nextafter(NOW - 2.0, 0.0), "no setpoint for"),
        (-math.inf, "no setpoint for"),
    ],
)
def test_setpoint_age(valid_until, reason, gate, healthy):
    said = ask(gate, healthy, setpoint=replace(SETPOINT, valid_until=valid_until))
    assert verdict(gate, reason, said)


def test_a_pose_age_that_is_not_a_number(gate, healthy):
    assert ask(gate, replace(healthy, pose_age=math.nan)) is not None


def test_a_setpoint_age_that_is_not_a_number(gate, healthy):
    assert ask(gate, healthy, setpoint=replace(SETPOINT, valid_until=math.nan)) is not None


@pytest.mark.parametrize(
    ("age", "reason"),
    [(up(-EARLY), OK), (-EARLY, "no pose for"), (-5.0, "no pose for"), (-math.inf, "no pose for")],
)
def test_a_pose_from_the_future(age, reason, gate, healthy):
    assert verdict(gate, reason, ask(gate, replace(healthy, pose_age=age)))


# Latching


@pytest.mark.parametrize(
    "change",
    [
        {"pose_age": 0.6},
        {"rejected": 99},
        {"pose": Pose(3.0, 0.0, 0.0)},
        {"twist": Twist(0.0, 0.0, 2.0)},
        {"pose": Pose(math.nan, 0.0, 0.0)},
    ],
)
def test_a_fault_stays(change, gate, healthy):
    reason = ask(gate, replace(healthy, **change))
    assert reason is not None
    assert ask(gate, healthy) == reason
    assert ask(gate, None) == reason
    assert ask(gate, healthy, armed=False) == reason
    assert ask(gate, replace(healthy, pose=Pose(-9.0, 0.0, 0.0))) == reason
    assert gate.fault == reason


def test_gates_do_not_share_their_faults(healthy):
    one, other = Gate(PARAMS, FENCE), Gate(PARAMS, FENCE)
    assert ask(one, replace(healthy, rejected=99)) is not None
    assert ask(other, healthy) is None


@pytest.mark.parametrize("pressure", [math.nan, math.inf])
def test_a_pressure_that_is_no_number_shuts_the_valves_and_says_so(pressure, gate, healthy):
    health = Health(NOW, pressure, 20e6)
    assert ask(gate, healthy, health=health) == Refusal(InhibitReason.SUPPLY_NOT_FINITE)
    assert gate.fault.words == "supply pressure is not a number"


def test_the_first_reason_stays_when_there_are_two(gate, healthy):
    said = ask(gate, replace(healthy, rejected=99), health=Health(NOW, math.nan, 2e7))
    assert "contradict" in said.words


def test_an_unusual_gate_is_asked_for():
    assert GateParams() == GateParams(
        pose_timeout_s=0.5, blind_s=4.0, link_timeout_s=2.0, max_rejected=30, max_speed=0.6,
        max_spin=1.5, fence_margin=0.0,
    )  # fmt: skip
    assert (EARLY, AHEAD) == (1e-3, 0.05)


# Sessions


def test_setpoints_of_another_session_open_nothing_and_are_no_fault(gate, healthy):
    assert ask(gate, healthy, session_ok=False) == Refusal(InhibitReason.OTHER_SESSION)
    assert gate.fault is None
    assert ask(gate, healthy) is None


# Braking


BRAKING = [
    # it needs no setpoint, of no session, and may be fast
    ({}, {"setpoint": None}, OK),
    ({}, {"setpoint": replace(SETPOINT, valid_until=NOW - 9.0)}, OK),
    ({}, {"session_ok": False}, OK),
    ({"twist": Twist(2.0, 0.0, 3.0)}, {}, OK),
    # and flies on its own prediction for a while
    ({"pose_age": 1.5}, {}, OK),
    ({"pose_age": 1.5, "rejected": 99}, {}, OK),
    ({"pose_age": up(1.5)}, {}, "no pose for"),
    # everything else is as ever
    ({}, {"armed": False}, "not armed"),
    ({"pose": Pose(up(2.8), 0.0, 0.0)}, {}, "outside the fence"),
    ({"twist": Twist(math.nan, 0.0, 0.0)}, {}, "not a number"),
    ({}, {"wanted": Wrench(math.nan, 0.0, 0.0)}, "not a number"),
    ({}, {"health": Health(NOW, math.nan, 2e7)}, "supply pressure"),
]


@pytest.mark.parametrize(("change", "options", "reason"), BRAKING)
def test_what_shuts_the_valves_of_a_vehicle_that_brakes(change, options, reason, gate, healthy):
    said = ask(gate, replace(healthy, **change), braking=True, **options)
    assert said is None if reason is OK else reason in said.words


def test_braking_does_not_shorten_the_patience_for_poses(healthy):
    gate = Gate(replace(PARAMS, blind_s=0.1), FENCE)
    assert ask(gate, replace(healthy, pose_age=0.5), braking=True) is None


def test_a_vehicle_that_never_saw_itself_does_not_brake(gate):
    assert ask(gate, None, braking=True) == Refusal(InhibitReason.NO_POSE_YET)


def test_a_reset_forgets_the_fault(gate, healthy):
    assert ask(gate, replace(healthy, rejected=99)) is not None
    gate.reset()
    assert gate.fault is None
    assert ask(gate, healthy) is None


# Plans at the port


PLAN = ValveCommand(8, NOW, NOW + 0.1, (5000, 0, 100_000), (10_000, 0, 0))


@pytest.mark.parametrize(
    ("change", "now", "newest", "reason"),
    [
        ({}, NOW, 7, OK),
        ({}, NOW - AHEAD / 2, 7, OK),
        ({}, NOW - 2 * AHEAD, 7, "from the future"),
        ({}, math.nextafter(NOW + 0.1, 0.0), 7, OK),
        ({}, NOW + 0.1, 7, "expired"),
        ({}, math.nan, 7, "from the future"),
        ({}, NOW, 8, "plan 8 after plan 8"),
        ({}, NOW, 9, "plan 8 after plan 9"),
        ({"valid_until": NOW}, NOW, 7, "a plan of 0.000 s"),
        ({"valid_until": NOW - 1.0}, NOW, 7, "a plan of -1.000 s"),
        ({"valid_until": NOW + 0.2}, NOW, 7, "a plan of 0.200 s"),
        ({"valid_until": math.nan}, NOW, 7, "a plan of nan s"),
        ({"valid_until": math.inf}, NOW, 7, "a plan of inf s"),
        ({"offset_us": (0, 0)}, NOW, 7, "does not say when"),
        ({"on_us": (-1, 0, 0)}, NOW, 7, "a pulse of -1 us"),
        ({"on_us": (100_002, 0, 0), "offset_us": (0, 0, 0)}, NOW, 7, "a pulse of 100002 us"),
        ({"offset_us": (95_000, 0, 0)}, NOW, 7, OK),
        ({"offset_us": (95_002, 0, 0)}, NOW, 7, "after 95002 us"),
        ({"offset_us": (-1, 0, 0)}, NOW, 7, "after -1 us"),
    ],
)
def test_a_plan_at_the_port(change, now, newest, reason):
    said = refuse_plan(replace(PLAN, **change), now, newest, longest=0.1)
    assert said is None if reason is OK else reason in said.words


LONGEST, WHOLE = 0.1, 100_001  # [s], [us]: a pulse may be one longer, for rounding


@pytest.mark.parametrize(
    ("issued_at", "valid_until", "now", "reason"),
    [
        (0.0, LONGEST + EARLY, 0.0, OK),
        (0.0, up(LONGEST + EARLY), 0.0, "a plan of 0.101 s"),
        (0.0, 5e-324, 0.0, OK),
        (0.0, 0.0, -1.0, "a plan of 0.000 s"),
        (AHEAD, 0.1, 0.0, OK),
        (up(AHEAD), 0.1, 0.0, "from the future"),
    ],
)
def test_the_times_of_a_plan_to_the_last_bit(issued_at, valid_until, now, reason):
    plan = ValveCommand(8, issued_at, valid_until, (0,), (0,))
    said = refuse_plan(plan, now, 7, LONGEST)
    assert said is None if reason is OK else reason in said.words


@pytest.mark.parametrize(
    ("on", "offset", "ok"),
    [
        (WHOLE, 0, True), (WHOLE + 1, 0, False), (0, WHOLE, True), (0, WHOLE + 1, False),
        (40_000, WHOLE - 40_000, True), (40_000, WHOLE - 39_999, False),
        (0, 0, True), (-1, 0, False), (0, -1, False),
    ],
)  # fmt: skip
def test_the_pulses_of_a_plan_to_the_microsecond(on, offset, ok):
    said = refuse_plan(ValveCommand(8, 0.0, LONGEST, (0, on), (0, offset)), 0.0, 7, LONGEST)
    if ok:
        assert said is None
    else:
        assert said.words == f"a pulse of {on} us after {offset} us in a plan of 100000 us"
