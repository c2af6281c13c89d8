"""What the firmware does, at the limit and one microsecond beside it."""

import pytest

from firmware_interface.frame import Frame, encode, encode_message
from firmware_interface.messages import (
    Ack,
    Arm,
    Bearing,
    BearingPolicy,
    Cmd,
    Disarm,
    Fault,
    Hello,
    HelloAck,
    ResetCause,
    Result,
    State,
)

V0, V1, V5 = 1 << 0, 1 << 1, 1 << 5  # V5 pushes against V0


# Session and states


def test_hello_says_who_the_board_is(new_host):
    host = new_host(armed=False, board={"boot_nonce": 99})
    ack = host.hello()
    assert isinstance(ack, HelloAck)
    assert (ack.host_nonce, ack.boot_nonce, ack.state) == (7, 99, State.SAFE)
    assert ack.reset_cause == ResetCause.POWER_ON
    assert ack.session not in (0, 99)


@pytest.mark.parametrize("cause", list(ResetCause))
def test_every_boot_has_its_cause_another_nonce_and_nothing_open(host, cause):
    host.plan(1, {0: 100_000})
    before = host.hello()
    host.board.power_cycle(cause)
    host.listen()
    assert host.board.run_until(0) == []
    ack = host.hello()
    assert ack.reset_cause == cause
    assert (ack.boot_nonce, ack.session) != (before.boot_nonce, before.session)
    assert host.plan(1, {0: 100_000}).result == Result.NOT_ARMED


def test_a_board_whose_limits_contradict_each_other_never_arms(new_host):
    host = new_host(armed=False, min_on_us=500_000, max_on_us=400_000)
    assert host.hello().state == State.BOOT
    assert host.arm().result == Result.CONFIG_FAULT
    status = host.report()
    assert (status.state, status.faults) == (State.BOOT, Fault.CONFIG)
    host.disarm()
    assert host.ping().state == State.BOOT


def test_status_without_usable_limits_still_has_a_period(new_host):
    host = new_host(armed=False, status_period_us=0)
    host.listen()
    host.wait(1_000_000)
    assert len(host.listen()) == 10


def test_nothing_opens_before_arm(new_host):
    host = new_host(armed=False)
    assert host.plan(1, {0: 100_000}).result == Result.NOT_ARMED
    assert host.wait(200_000) == []
    assert host.arm().state == State.ARMED
    assert host.plan(1, {0: 100_000}).result == Result.OK
    assert host.wait(0) == [(200_000, V0)]


def test_disarm_closes_at_once_and_needs_no_session(host):
    host.plan(1, {0: 100_000})
    host.wait(5_000)
    host.session = 0
    ack = host.disarm()
    assert (ack.result, ack.state, ack.faults) == (Result.OK, State.SAFE, 0)
    assert host.wait(100_000) == [(0, V0), (5_000, 0)]


@pytest.mark.parametrize("first", ["disarm", "hello"])
def test_arming_right_behind_does_not_save_the_old_plan(host, first):
    """Three frames in one read of the port: no run comes between them."""

    host.plan(1, {0: 100_000})
    host.wait(20_000)
    if first == "disarm":
        frames = encode_message(Disarm(), 50, 0) + encode_message(Arm(host.session), 51, 0)
    else:
        again = (host.session + 0x9E3779B9) % (1 << 32)
        frames = encode_message(Hello(1), 50, 0) + encode_message(Arm(again), 51, 0)
    host.board.feed(frames)
    assert host.ping().state == State.ARMED
    assert host.wait(100_000) == [(0, V0), (20_000, 0)]


def test_a_plan_right_behind_disarm_and_arm_waits_for_the_minimum_off_time(host):

    host.plan(1, {0: 100_000})
    host.wait(20_000)
    cmd = Cmd(host.session, 2, 0, 500_000, (50_000,) + (0,) * 7, (0,) * 8)
    host.board.feed(
        encode_message(Disarm(), 50, 0)
        + encode_message(Arm(host.session), 51, 0)
        + encode_message(cmd, 52, 0)
    )
    up = 20_000 + host.limits.min_off_us
    assert host.wait(100_000) == [(0, V0), (20_000, 0), (up, V0), (70_000, 0)]


def test_hello_closes_disarms_and_ends_the_session_before(host):
    old = host.session
    host.plan(1, {0: 100_000})
    host.wait(5_000)
    assert host.hello().state == State.SAFE
    assert host.wait(0) == [(0, V0), (5_000, 0)]
    host.session, new = old, host.session
    assert new != old
    assert host.arm().result == Result.FOREIGN_SESSION
    assert host.report().foreign == 1


def test_arm_twice_is_fine_and_does_not_feed_the_watchdog(host):
    host.plan(1, {0: 300_000})
    host.wait(100_000)
    assert host.arm().result == Result.OK
    assert host.wait(100_000)[-1] == (host.limits.watchdog_us, 0)


# Watchdog


def test_watchdog_closes_to_the_microsecond_and_latches(host):
    host.plan(1, {0: 300_000})
    assert host.wait(host.limits.watchdog_us - 1) == [(0, V0)]
    assert host.wait(1) == [(0, V0), (host.limits.watchdog_us, 0)]
    assert host.plan(2, {0: 100_000}).result == Result.NOT_ARMED
    status = host.report()
    assert (status.state, status.faults) == (State.SAFE, Fault.WATCHDOG)
    assert status.watchdog_trips == 1
    ack = host.arm()
    assert (ack.state, ack.faults) == (State.ARMED, 0)


def test_a_plan_one_microsecond_before_the_watchdog_saves_the_session(host):
    host.plan(1, {0: 400_000})
    host.wait(host.limits.watchdog_us - 1)
    assert host.plan(1, {0: 400_000}).result == Result.REFRESHED
    assert host.wait(host.limits.watchdog_us - 1) == [(0, V0)]
    assert host.wait(1) == [(0, V0), (2 * host.limits.watchdog_us - 1, 0)]


def test_armed_without_any_plan_trips_too(host):
    host.wait(host.limits.watchdog_us - 1)
    assert host.ping().state == State.ARMED  # and ping feeds nothing
    host.wait(1)
    assert host.ping().faults == Fault.WATCHDOG


def test_a_refused_plan_feeds_nothing(host):
    host.plan(5, {0: 300_000})
    host.wait(100_000)
    assert host.plan(4, {0: 300_000}).result == Result.STALE_PLAN
    assert host.plan(6, {0: 500_000}).result == Result.ON_TOO_LONG
    assert host.wait(100_000)[-1] == (host.limits.watchdog_us, 0)


# Plans


def test_pulses_are_exact_and_a_refresh_does_not_restart_them(host):
    host.plan(1, {0: 60_000, 3: 20_000}, {3: 30_001})
    host.wait(10_000)
    assert host.plan(1, {0: 60_000, 3: 20_000}, {3: 30_001}, age=10_000).result == Result.REFRESHED
    assert host.wait(100_000) == [(0, V0), (30_001, V0 | 8), (50_001, V0), (60_000, 0)]


def test_a_refresh_after_a_lost_frame_starts_the_plan_where_it_would_be(host):
    host.wait(50_000)
    host.plan(1, {0: 60_000, 1: 30_000}, {1: 50_000}, age=20_000)
    assert host.wait(100_000) == [(50_000, V0), (80_000, V0 | V1), (90_000, V1), (110_000, 0)]


def test_of_a_pulse_under_way_too_little_is_left(host):
    on = 50_000
    late = on - host.limits.min_on_us
    host.plan(1, {0: on}, age=late + 1)
    assert host.wait(100_000) == []
    host.plan(2, {0: on}, age=late)
    assert host.wait(100_000) == [(100_000, V0), (100_000 + host.limits.min_on_us, 0)]


def test_nothing_is_open_past_the_time_to_live(host):
    host.plan(1, {0: 60_000, 1: 60_000}, {1: 20_000}, ttl=40_000)
    assert host.wait(100_000) == [(0, V0), (20_000, V0 | V1), (40_000, 0)]


@pytest.mark.parametrize(("ttl", "age", "result"), [
    (100_000, 99_999, Result.OK),
    (100_000, 100_000, Result.EXPIRED),
    (900_001, 0, Result.OK),
    (900_002, 0, Result.TTL_TOO_LONG),
])  # fmt: skip
def test_time_to_live(host, ttl, age, result):
    assert host.plan(1, {}, ttl=ttl, age=age).result == result


def test_a_new_plan_closes_what_it_does_not_continue_at_once(host):
    host.plan(1, {0: 100_000, 1: 100_000})
    host.wait(3_000)
    host.plan(2, {1: 50_000})
    assert host.wait(100_000) == [(0, V0 | V1), (3_000, V1), (53_000, 0)]


def test_a_new_plan_can_end_an_opening_before_its_minimum_on_time(host):
    host.plan(1, {0: 100_000})
    host.wait(3_000)
    host.plan(2, {0: 100})
    assert host.wait(100_000) == [(0, V0), (3_100, 0)]


def test_a_pulse_that_continues_one_without_a_gap_is_the_same_opening(host):
    host.plan(1, {0: 50_000})
    host.wait(50_000)
    host.plan(2, {0: 50_000})
    assert host.wait(100_000) == [(0, V0), (100_000, 0)]


def test_one_microsecond_later_it_is_a_new_one(host):
    host.plan(1, {0: 50_000})
    host.wait(50_001)
    host.plan(2, {0: 50_000})
    up = 50_000 + host.limits.min_off_us
    assert host.wait(100_000) == [(0, V0), (50_000, 0), (up, V0), (100_001, 0)]


def test_an_older_plan_is_refused_and_numbers_wrap(host):
    assert host.plan(0xFFFFFFFF, {0: 50_000}).result == Result.OK
    assert host.plan(0xFFFFFFFE, {}).result == Result.STALE_PLAN
    assert host.plan(0, {1: 50_000}).result == Result.OK
    assert host.plan(0xFFFFFFFF, {0: 50_000}).result == Result.STALE_PLAN
    assert host.plan(0x7FFFFFFF, {}).result == Result.OK
    assert host.plan(0xFFFFFFFF, {}).result == Result.STALE_PLAN


def test_a_plan_from_before_disarm_is_not_resumed(host):
    host.plan(1, {0: 100_000})
    host.disarm()
    host.arm()
    host.listen()
    assert host.plan(1, {0: 100_000}).result == Result.REFRESHED
    assert host.wait(100_000) == []  # open and closed in one microsecond


# Limits of one valve


@pytest.mark.parametrize("less", [0, 1])
def test_minimum_on_time(host, less):
    on = host.limits.min_on_us - less
    host.plan(1, {2: on})
    assert host.wait(100_000) == ([] if less else [(0, 4), (on, 0)])
    assert host.report().unplayed == less


@pytest.mark.parametrize("less", [0, 1])
def test_after_the_minimum_off_time_what_is_left_must_be_long_enough(host, less):
    host.plan(1, {0: 20_000})
    host.wait(30_000)  # closed at 20 000
    host.plan(2, {0: 20_000})
    host.wait(25_000)  # closed at 50 000, now 55 000
    up = 50_000 + host.limits.min_off_us
    on = up - 55_000 + host.limits.min_on_us - less
    host.plan(3, {0: on})
    host.wait(100_000)
    assert host.edges_from(55_000) == ([] if less else [(up, V0), (55_000 + on, 0)])


def test_an_on_time_above_the_limit_is_refused(host):
    assert host.plan(1, {0: host.limits.max_on_us + 1}).result == Result.ON_TOO_LONG
    assert host.plan(1, {0: host.limits.max_on_us}).result == Result.OK


def test_no_chain_of_plans_keeps_a_valve_open_for_longer(host):
    for number in range(8):
        host.plan(number, {0: 100_000})
        edges = host.wait(100_000)
    cut = host.limits.max_on_us
    up = 500_000  # the plan that was cut is over; the next one opens again
    assert edges[:3] == [(0, V0), (cut, 0), (up, V0)]
    assert host.report().cut_max_on == 1


def test_max_on_beats_a_plan_by_one_microsecond_only(host):
    host.plan(1, {0: 100_000})
    host.wait(100_000)
    left = host.limits.max_on_us - 100_000
    host.plan(2, {0: left})
    host.keep_alive(2, 100_000 + left + 1)
    assert host.report().cut_max_on == 0


def pulses_until(host, total_us, on=100_000, gap=10_000):
    """Open V0 again and again for `total_us` in all; the last plan's number."""
    number = opened = 0
    while opened < total_us:
        number += 1
        pulse = min(on, total_us - opened)
        host.plan(number, {0: pulse})
        host.wait(pulse + gap)
        opened += pulse
    return number


def test_duty_budget_cuts_to_the_microsecond(host):
    budget = host.limits.duty_budget_us
    number = pulses_until(host, budget - 50_000)
    start = host.board.now_us
    host.plan(number + 1, {0: 100_000, 1: 100_000})
    host.wait(100_000)
    assert host.edges_from(start) == [
        (start, V0 | V1), (start + 50_000, V1), (start + 100_000, 0),
    ]  # fmt: skip
    status = host.report()
    assert (status.cut_duty, status.cut_max_on) == (1, 0)
    assert status.open_us[:2] == (budget, 100_000)
    again = host.board.now_us
    host.plan(number + 2, {0: 100_000})
    host.wait(100_000)
    assert host.edges_from(again) == []  # nothing left


def test_duty_comes_back_when_the_window_has_passed(host):
    budget, window = host.limits.duty_budget_us, host.limits.duty_window_us
    pulses_until(host, budget)
    host.keep_alive(1000, window * 17 // 16 + 1)
    now = host.board.now_us
    host.plan(1001, {0: 100_000})
    assert host.edges_from(now) == [(now, V0)]


@pytest.mark.parametrize("less", [0, 1])
def test_less_duty_than_a_minimum_pulse_opens_nothing(host, less):
    budget = host.limits.duty_budget_us
    number = pulses_until(host, budget - host.limits.min_on_us + less)
    now = host.board.now_us
    host.plan(number + 1, {0: 50_000})
    host.wait(100_000)
    assert len(host.edges_from(now)) == (0 if less else 2)


def test_a_valve_the_board_does_not_have_is_refused(new_host):
    host = new_host(valve_count=2, opposing=(2, 1, 0, 0, 0, 0, 0, 0))
    assert host.plan(1, {2: 50_000}).result == Result.NO_SUCH_VALVE
    assert host.plan(1, {1: 50_000}).result == Result.OK


@pytest.mark.parametrize(
    ("field", "value", "inside"),
    [
        ("ttl_us", 10_000_000, True),
        ("ttl_us", 10_000_001, False),
        ("ttl_us", 0, False),
        ("age_us", 10_000_000, True),
        ("age_us", 10_000_001, False),
        ("on_us", (*(0,) * 7, 10_000_000), True),
        ("on_us", (*(0,) * 7, 10_000_001), False),
        ("offset_us", (10_000_000, *(0,) * 7), True),
        ("offset_us", (10_000_001, *(0,) * 7), False),
    ],
)
def test_fields_outside_the_protocol_are_refused(new_host, field, value, inside):
    host = new_host(max_ttl_us=10_000_000, max_on_us=10_000_000)
    good = {"age_us": 0, "ttl_us": 500_000, "on_us": (0,) * 8, "offset_us": (0,) * 8}
    payload = Cmd(host.session, 1, **(good | {field: value})).pack()
    host.listen()
    host.board.feed(encode(Frame(Cmd.CODE, 99, 0, payload)))
    ack = next(m for m in host.listen() if isinstance(m, Ack))
    assert (ack.result == Result.OUT_OF_RANGE) is not inside


# Opposing valves


@pytest.mark.parametrize("less", [0, 1])
def test_a_plan_must_keep_the_dead_time(host, less):
    gap = host.limits.dead_us - less
    for number, (first, second) in enumerate(((0, 5), (5, 0), (3, 6), (6, 3))):
        ack = host.plan(number, {first: 20_000, second: 20_000}, {second: 20_000 + gap})
        assert ack.result == (Result.OPPOSING if less else Result.OK)


def test_valves_that_do_not_oppose_may_open_together(host):
    assert host.plan(1, {0: 20_000, 1: 20_000, 2: 20_000, 3: 20_000}).result == Result.OK
    assert host.wait(0) == [(0, 15)]


def test_from_plan_to_plan_the_opposite_valve_waits_for_the_dead_time(host):
    host.plan(1, {0: 100_000})
    host.wait(30_000)
    host.plan(2, {5: 40_000})
    up = 30_000 + host.limits.dead_us
    assert host.wait(100_000) == [(0, V0), (30_000, 0), (up, V5), (70_000, 0)]


@pytest.mark.parametrize("valve", [0, 5])
def test_output_stage_closes_all_when_a_bit_flips_to_opposing(host, valve):
    host.plan(1, {valve: 100_000, 1: 100_000})
    host.wait(20_000)
    host.board.lib.board_flip_open(host.board.handle, 5 - valve)
    assert host.wait(100_000) == [(0, 1 << valve | V1), (20_000, 0)]
    status = host.report()
    assert (status.state, status.faults) == (State.SAFE, Fault.INTERLOCK)


@pytest.mark.parametrize("less", [0, 1])
def test_output_stage_keeps_the_dead_time_against_a_flipped_bit(host, less):
    host.plan(1, {0: 20_000})
    host.wait(20_000 + host.limits.dead_us - less)
    host.board.lib.board_flip_open(host.board.handle, 5)
    now = host.board.now_us
    assert host.wait(0) == [(0, V0), (20_000, 0)] + ([] if less else [(now, V5)])
    assert host.ping().faults == (Fault.INTERLOCK if less else 0)


def test_output_stage_remembers_what_it_closed_itself(host):
    host.plan(1, {0: 100_000})
    host.wait(20_000)
    host.board.lib.board_flip_open(host.board.handle, 5)
    host.arm()
    host.wait(host.limits.dead_us - 1)
    host.board.lib.board_flip_open(host.board.handle, 5)
    assert host.ping().faults == Fault.INTERLOCK


# Supply and bearing


def test_undervoltage_trips_after_its_time_to_the_microsecond(host):
    host.plan(1, {0: 100_000})
    host.wait(20_000)
    host.board.sense(host.limits.undervoltage_mv - 1, 0)
    end = 20_000 + host.limits.undervoltage_us
    assert host.wait(50_000) == [(0, V0), (end, 0)]
    assert host.arm().result == Result.UNDERVOLTAGE
    host.board.sense(host.limits.undervoltage_mv, 0)
    assert host.ping().faults == Fault.UNDERVOLTAGE
    assert host.arm().state == State.ARMED


def test_a_dip_shorter_than_that_trips_nothing(host):
    host.plan(1, {0: 100_000})
    for _ in range(3):
        host.board.sense(host.limits.undervoltage_mv - 1, 0)
        host.wait(host.limits.undervoltage_us - 1)
        host.board.sense(host.limits.undervoltage_mv, 0)
    assert host.ping().mask == V0


def test_sensors_are_reported(host):
    host.board.sense(21_987, 432_100)
    status = host.report()
    assert (status.supply_mv, status.supply_pa) == (21_987, 432_100)


def test_bearing_air_needs_a_session_but_not_armed(new_host):
    host = new_host(armed=False)
    assert not host.board.bearing
    assert host.bearing(True).result == Result.OK
    assert host.board.bearing
    assert host.report().bearing == 1
    session, host.session = host.session, 0
    assert host.bearing(False).result == Result.FOREIGN_SESSION
    host.session = session
    assert host.board.bearing
    assert host.bearing(False).result == Result.OK
    assert not host.board.bearing


def test_bearing_is_on_or_off_only(host):

    host.listen()
    host.board.feed(encode(Frame(Bearing.CODE, 99, 0, Bearing(host.session, 2).pack())))
    assert host.listen()[-1].result == Result.OUT_OF_RANGE
    assert not host.board.bearing


LAND = {"bearing_after_trip": BearingPolicy.DROP, "land_after_us": 70_003}


def trip_by(host, cause):
    """Make the board trip now."""
    match cause:
        case "watchdog":
            host.wait(host.limits.watchdog_us)
        case "undervoltage":
            host.board.sense(17_999, 0)
            host.wait(host.limits.undervoltage_us)
        case "interlock":
            host.board.lib.board_flip_open(host.board.handle, 0)
            host.board.lib.board_flip_open(host.board.handle, 5)
    assert host.ping().state == State.SAFE


@pytest.mark.parametrize("cause", ["watchdog", "undervoltage", "interlock"])
def test_after_a_trip_the_board_lands_when_its_limits_say_so(new_host, cause):
    host = new_host(**LAND)
    host.bearing(True)
    trip_by(host, cause)
    host.wait(70_002)
    assert host.board.bearing
    host.wait(1_000)  # between two runs
    assert not host.board.bearing
    host.arm()
    host.wait(10)
    assert not host.board.bearing


@pytest.mark.parametrize("cause", ["watchdog", "undervoltage", "interlock"])
def test_without_a_delay_it_lands_in_the_run_that_trips(new_host, cause):
    host = new_host(**LAND | {"land_after_us": 0})
    host.bearing(True)
    host.wait(10)
    trip_by(host, cause)
    assert not host.board.bearing


def test_bearing_air_stays_on_after_a_trip_if_the_limits_say_so(new_host):
    host = new_host(land_after_us=70_003)
    host.bearing(True)
    host.wait(1_000_000)
    assert host.ping().state == State.SAFE
    assert host.board.bearing


@pytest.mark.parametrize("order", ["arm", "bearing"])
def test_a_sender_that_comes_back_in_time_keeps_the_air_on(new_host, order):
    host = new_host(**LAND)
    host.bearing(True)
    host.wait(host.limits.watchdog_us + 70_000)
    assert host.board.bearing
    host.arm() if order == "arm" else host.bearing(True)
    host.wait(100_000)
    assert host.board.bearing


@pytest.mark.parametrize("order", ["disarm", "ping", "hello"])
def test_a_frame_that_decides_nothing_does_not_keep_it_on(new_host, order):
    host = new_host(**LAND)
    host.bearing(True)
    host.wait(host.limits.watchdog_us + 70_000)
    getattr(host, order)()
    host.wait(1_000)
    assert not host.board.bearing


def test_a_disarmed_board_does_not_land(new_host):
    """A sender that disarms is alive, and says BEARING when it wants to land."""
    host = new_host(**LAND)
    host.bearing(True)
    host.disarm()
    host.wait(1_000_000)
    assert host.board.bearing


# Limits that contradict each other, or not quite


@pytest.mark.parametrize(
    ("limits", "state"),
    [
        ({"opposing": (1, *(0,) * 7)}, State.BOOT),  # against itself
        ({"opposing": (2, *(0,) * 7)}, State.BOOT),  # one-sided
        ({"opposing": (2, 1, *(0,) * 6)}, State.SAFE),
        ({"opposing": (4, 0, 1, *(0,) * 5), "valve_count": 2}, State.BOOT),  # not there
        ({"opposing": (0, 0, 1, *(0,) * 5), "valve_count": 2}, State.BOOT),
        ({"opposing": (0,) * 8, "valve_count": 0}, State.BOOT),
        ({"valve_count": 9}, State.BOOT),
        ({"max_on_us": 10_007}, State.SAFE),
        ({"max_on_us": 10_006}, State.BOOT),
        ({"duty_budget_us": 10_006}, State.BOOT),
        ({"duty_budget_us": 10_007}, State.SAFE),
        ({"duty_budget_us": 3_200_000}, State.SAFE),
        ({"duty_budget_us": 3_200_001}, State.BOOT),
        ({"duty_window_us": 3_200_001}, State.BOOT),
        ({"watchdog_us": 2_000_001}, State.BOOT),
        ({"watchdog_us": 999}, State.BOOT),
        ({"land_after_us": 60_000_000}, State.SAFE),
        ({"land_after_us": 60_000_001}, State.BOOT),
    ],
)
def test_limits_are_checked_at_boot(new_host, limits, state):
    assert new_host(armed=False, **limits).ping().state == state


def test_edges_that_are_not_fetched_in_time_are_counted(host):
    """A burst within one frame's time overflows the ring: the port sent nothing meanwhile."""
    host.board.lib.board_hold(host.board.handle, 1)
    for number in range(40):
        host.plan(number, {0: 10_007})
        host.wait(20_000)
    host.board.lib.board_hold(host.board.handle, 0)
    assert host.report().lost_edges == 80 - 64


def test_a_late_run_is_reported(host):
    host.board.lib.board_oversleep(host.board.handle, 700)
    assert host.report().worst_late_us == 700


def test_a_pulse_that_is_over_before_its_valve_is_free_is_not_played(new_host):
    host = new_host(min_off_us=50_000)
    host.plan(1, {0: 20_000})
    host.wait(25_000)
    host.plan(2, {0: 20_000})
    assert host.wait(100_000) == [(0, 1), (20_000, 0)]
    assert host.report().unplayed == 1
