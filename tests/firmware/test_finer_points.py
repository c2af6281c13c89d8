"""What only a fault in the core brought up: each of these kills mutants that nothing else did."""

import pytest

from firmware_interface.compiler import firmware_id
from firmware_interface.frame import Decoder, encode_message
from firmware_interface.limits import config_hash
from firmware_interface.messages import (
    VERSION,
    Ack,
    Arm,
    Cmd,
    Disarm,
    Edges,
    Fault,
    Hello,
    HelloAck,
    Ping,
    Result,
    State,
    Status,
)

V0, V5 = 1 << 0, 1 << 5
PAIRS = [(0, 5), (1, 4), (2, 7), (3, 6)]
BOTH_WAYS = PAIRS + [(b, a) for a, b in PAIRS]


def frames(host):
    return Decoder().feed(host.board.read())


def cmd(host, number, on, offset=None):
    spread = [tuple((d or {}).get(v, 0) for v in range(8)) for d in (on, offset)]
    return Cmd(host.session, number, 0, 900_000, *spread)


# What is said


def test_hello_names_limits_and_firmware(new_host):
    host = new_host(armed=False)
    ack = host.hello()
    assert ack.config_hash == config_hash(host.limits)
    assert ack.firmware_id == firmware_id()
    assert host.ping().faults == 0


def test_frames_carry_version_number_and_time(new_host):
    host = new_host(armed=False, board={"clock_us": 0x9000_0000})
    host.listen()
    host.wait(1_003)
    host.board.feed(b"".join(encode_message(Ping(), n, 0) for n in range(3)))
    heard = frames(host)
    assert [f.version for f in heard] == [VERSION] * 3
    assert [f.seq - heard[0].seq for f in heard] == [0, 1, 2]
    assert heard[0].seq == 2  # behind the first STATUS and the answer to HELLO
    assert {f.t_us for f in heard} == {0x9000_0000 + 1_003}


def test_the_first_status_comes_at_boot(new_host):
    host = new_host(armed=False, board={"clock_us": 0x9000_0000})
    assert [type(m) for m in host.heard][:2] == [Status, HelloAck]


def test_status_says_whose_session_what_is_open_and_which_plan(host):
    host.plan(77, {0: 300_000})
    status = host.report()
    assert (status.session, status.mask, status.plan) == (host.session, V0, 77)


def test_only_refusals_are_counted_as_refused(host):
    host.plan(1, {})
    host.plan(1, {})
    assert host.report().refused == 0
    host.plan(0, {})
    host.plan(2, {0: 1_000_000})
    assert host.report().refused == 2


def test_nothing_between_two_delimiters_is_no_frame_and_one_byte_is_a_bad_one(host):
    host.board.feed(b"\0\0\0")
    assert host.report().bad_length == 0
    host.board.feed(b"\1\0")
    assert host.report().bad_length == 1


def test_a_block_that_points_one_byte_beyond_the_end_is_not_cobs(host):
    host.board.feed(b"\x16" + b"\x01" * 20 + b"\0")
    status = host.report()
    assert (status.bad_length, status.bad_crc) == (1, 0)


def test_edges_that_had_to_wait_are_reported_as_they_were(host):
    """Longer than a duty slot, and not from the beginning of the ring."""
    for number in range(1, 4):
        host.plan(number, {0: 12_000})
        host.wait(30_000)
    host.listen()
    before = len(host.edges)
    host.board.lib.board_hold(host.board.handle, 1)
    for number in range(4, 36):
        host.plan(number, {number % 4: 11_000 + number})
        host.wait(30_000)
    host.board.lib.board_hold(host.board.handle, 0)
    host.wait(1_000)
    told = [
        pair
        for m in host.listen()
        if isinstance(m, Edges)
        for pair in list(zip(m.at_us, m.mask, strict=True))[: m.count]
    ]
    assert len(told) == 64
    assert told == [tuple(edge) for edge in host.edges[before:]]


# Sessions


def test_hello_forgets_sequence_and_plan_numbers(host):
    host.seq = 5_000
    host.plan(1_000, {})
    host.hello()
    host.seq = 3
    assert host.arm().result == Result.OK
    assert host.plan(1, {}).result == Result.OK


def test_the_first_frame_of_a_session_may_have_any_number(new_host):
    host = new_host(armed=False)
    assert host.send(Arm(host.session), seq=0).result == Result.OK
    host.hello()
    assert host.send(Arm(host.session), seq=0).result == Result.OK


def test_answers_to_the_session_before_are_not_sent_after_hello(host):
    host.listen()
    pings = b"".join(encode_message(Ping(), n, 0) for n in range(3))
    host.board.feed(pings + encode_message(Hello(9), 50, 0))
    assert [type(m) for m in host.listen()] == [HelloAck]


# Plans that must not come back


def test_a_plan_ahead_of_disarm_in_the_same_read_is_not_played_after_arm(host):
    data = encode_message(cmd(host, 1, {0: 50_000}), 50, 0)
    data += encode_message(Disarm(), 51, 0) + encode_message(Arm(host.session), 52, 0)
    host.board.feed(data)
    assert host.ping().state == State.ARMED
    assert host.wait(100_000) == []


def test_a_plan_that_came_together_with_a_trip_is_not_played_after_arm(host):
    host.board.sense(host.limits.undervoltage_mv - 1, 0)
    host.board.skip(host.limits.undervoltage_us)
    assert host.plan(1, {0: 50_000}).result == Result.OK  # then the run that trips
    assert host.ping().faults == Fault.UNDERVOLTAGE
    host.board.sense(host.limits.undervoltage_mv, 0)
    assert host.arm().state == State.ARMED
    assert host.wait(100_000) == []


def test_a_pulse_not_begun_is_forgotten_by_disarm(host):
    host.plan(1, {0: 50_000}, {0: 50_000})
    host.wait(10_000)
    host.disarm()
    host.arm()
    assert host.wait(100_000) == []


def test_a_pulse_not_begun_is_forgotten_by_the_next_plan(host):
    host.plan(1, {0: 50_000}, {0: 50_000})
    host.wait(10_000)
    host.plan(2, {})
    assert host.wait(100_000) == []
    assert host.report().unplayed == 0


def test_of_two_plans_at_one_instant_the_second_counts(host):
    """What the first would have opened later neither happens nor restarts the opening."""
    host.plan(1, {0: 100_000})
    host.wait(50_000)
    host.plan(2, {0: 50_000}, {0: 100_000})
    host.plan(3, {0: 400_000})
    host.keep_alive(3, 500_000)
    assert host.edges == [(0, V0), (host.limits.max_on_us, 0)]


# One valve


def test_a_pulse_with_a_gap_before_it_does_not_continue_an_opening(host):
    host.plan(1, {0: 100_000})
    host.wait(30_000)
    host.plan(2, {0: 50_000}, {0: 20_000})
    assert host.wait(100_000) == [(0, V0), (30_000, 0), (50_000, V0), (100_000, 0)]


def test_no_pulse_at_an_offset_closes_at_once(host):
    host.plan(1, {0: 100_000})
    host.wait(30_000)
    host.plan(2, {}, {0: 20_000})
    assert host.wait(100_000) == [(0, V0), (30_000, 0)]


def test_a_pulse_that_was_over_before_it_came_closes_and_counts_as_unplayed(host):
    host.plan(1, {0: 300_000})
    host.wait(50_000)
    host.plan(2, {0: 20_000}, age=20_000)
    assert host.wait(20_000) == [(0, V0), (50_000, 0)]
    assert host.report().unplayed == 1


def test_a_pulse_for_which_too_little_is_left_counts_as_unplayed(host):
    host.plan(1, {0: 20_000})
    host.wait(25_000)
    host.plan(2, {0: host.limits.min_on_us})
    assert host.wait(100_000) == [(0, V0), (20_000, 0)]
    assert host.report().unplayed == 1


def test_a_pulse_that_is_over_before_its_valve_is_free_is_given_up_then(new_host):
    host = new_host(min_off_us=500_000)
    host.plan(1, {0: 20_000})
    host.wait(25_000)
    host.plan(2, {0: 20_000})
    assert host.report().unplayed == 1


def test_a_pulse_of_a_microsecond_is_played_where_that_is_allowed(new_host):
    host = new_host(min_on_us=0)
    host.plan(1, {0: 1})
    assert host.wait(10_000) == [(0, V0), (1, 0)]


def test_an_opening_cut_by_a_limit_is_not_continued(host):
    """A plan that comes in the microsecond of the cut must let the valve rest."""
    host.plan(1, {0: 300_000})
    host.wait(100_000)
    host.plan(2, {0: 400_000})
    host.wait(100_000)
    host.keep_alive(2, host.limits.max_on_us)
    host.plan(3, {0: 100_000})
    cut = host.limits.max_on_us
    assert host.wait(50_000) == [(0, V0), (cut, 0), (cut + host.limits.min_off_us, V0)]


def test_a_valve_that_never_opened_is_not_continued(new_host):
    """With the clock high, the stamp 0 of a closing that never was lies ahead."""
    host = new_host(board={"clock_us": 0xF000_0000})
    host.plan(1, {0: host.limits.min_on_us - 1})
    assert host.wait(50_000) == []


def test_a_rest_is_forgotten_by_every_valve_while_armed(new_host):
    """36 minutes on, the stamps of closings would lie ahead."""
    host = new_host(watchdog_us=2_000_000)
    host.plan(1, {6: 20_000, 7: 20_000})
    host.wait(50_000)
    for _ in range(36 * 30):
        host.board.skip(1_999_999)
        assert host.plan(1, {}).result == Result.REFRESHED
    now = host.board.now_us
    host.plan(2, {6: host.limits.min_on_us - 1})  # nothing there that it could continue
    assert host.edges_from(now) == []
    host.plan(3, {6: 20_000, 7: 20_000})
    assert host.edges_from(now) == [(now, 0xC0)]


def test_a_rest_is_forgotten_in_safe_too(host):
    """Armed and asked for a pulse in one read: no run in ARMED comes between."""
    host.plan(1, {6: 20_000})
    host.wait(200_000)
    for _ in range(36):
        host.board.skip(60_000_000)
        host.ping()
    now = host.board.now_us
    arm, plan = Arm(host.session), cmd(host, 2, {6: 20_000})
    host.board.feed(encode_message(arm, 50, 0) + encode_message(plan, 51, 0))
    assert host.edges_from(now) == [(now, 1 << 6)]


@pytest.mark.parametrize("how", ["plan", "disarm", "interlock"])
def test_open_time_is_counted_up_to_the_closing(host, how):
    host.plan(1, {0: 100_000})
    host.wait(12_345)
    if how == "plan":
        host.plan(2, {})
    elif how == "disarm":
        host.disarm()
    else:
        host.board.lib.board_flip_open(host.board.handle, 5)
    assert host.report().open_us[0] == 12_345


def test_a_pulse_slept_over_is_not_made_up_for(host):
    host.plan(1, {0: 20_000}, {0: 10_000})
    host.board.skip(50_000)
    host.ping()
    assert host.wait(50_000) == []
    assert host.report().unplayed == 1


# Duty


@pytest.mark.parametrize("valve", [0, 6])
def test_duty_comes_back_when_the_window_is_over_and_no_sooner(new_host, valve):
    """Spent at the end of a slot: one slot fewer would give it back too soon."""
    host = new_host(duty_window_us=1_600_000, duty_budget_us=50_000)
    host.plan(1, {valve: 50_000}, {valve: 49_000})
    host.keep_alive(1, 1_640_000)
    host.plan(2, {valve: 30_000})
    assert host.edges_from(1_640_000) == []
    host.keep_alive(2, 1_700_001)
    host.plan(3, {valve: 30_000})
    assert host.edges_from(1_640_000) == [(1_700_001, 1 << valve)]


def test_duty_is_counted_without_drift(new_host):
    host = new_host(duty_window_us=16_000, duty_budget_us=10_007)
    host.keep_alive(0, 500_000)
    host.plan(1, {0: 10_007})
    assert host.wait(20_000) == [(500_000, V0), (510_007, 0)]


def test_a_spent_budget_opens_nothing_not_even_for_an_instant(new_host):
    host = new_host(min_on_us=0, duty_budget_us=1)
    host.plan(1, {0: 100})
    assert host.wait(10_000) == [(0, V0), (1, 0)]
    host.plan(2, {0: 100})
    host.wait(10_000)
    status = host.report()
    assert (status.cut_duty, status.unplayed) == (1, 1)


# Opposing valves


@pytest.mark.parametrize(("first", "second"), BOTH_WAYS)
def test_every_pair_is_refused_in_one_plan(host, first, second):
    assert host.plan(1, {first: 20_000, second: 20_000}).result == Result.OPPOSING
    assert host.plan(2, {first: 1, second: 20_000}).result == Result.OPPOSING


def test_neighbours_may_oppose_too(new_host):
    host = new_host(opposing=(2, 1, 0, 0, 0, 0, 1 << 7, 1 << 6))
    assert host.plan(1, {0: 20_000, 1: 20_000}).result == Result.OPPOSING
    assert host.plan(2, {6: 20_000, 7: 20_000}).result == Result.OPPOSING


@pytest.mark.parametrize(("first", "second"), BOTH_WAYS)
def test_every_pair_keeps_the_dead_time_from_plan_to_plan(host, first, second):
    host.plan(1, {first: 100_000})
    host.wait(30_000)
    host.plan(2, {second: 40_000})
    up = 30_000 + host.limits.dead_us
    assert host.wait(50_000)[1:] == [(30_000, 0), (up, 1 << second), (70_000, 0)]
    assert host.ping().faults == 0


def test_others_need_no_dead_time(host):
    host.plan(1, {1: 100_000})
    host.wait(30_000)
    host.plan(2, {0: 40_000})
    assert host.wait(10_000) == [(0, 2), (30_000, V0)]


@pytest.mark.parametrize(("first", "second"), BOTH_WAYS)
def test_output_stage_knows_every_pair(host, first, second):
    host.plan(1, {first: 20_000})
    host.wait(20_000 + host.limits.dead_us - 1)
    host.board.lib.board_flip_open(host.board.handle, second)
    assert host.ping().faults == Fault.INTERLOCK


@pytest.mark.parametrize(("first", "second"), BOTH_WAYS)
def test_output_stage_forgets_when_the_dead_time_is_over(host, first, second):
    host.plan(1, {first: 20_000})
    host.wait(20_000 + host.limits.dead_us)
    host.plan(2, {second: 20_000})
    host.wait(50_000)
    assert host.ping().faults == 0
    assert host.edges[2:] == [(22_003, 1 << second), (42_003, 0)]


def test_the_scheduler_waits_for_an_opposite_that_is_open_by_mistake(host):
    """And does not leave it to the output stage, which would end the session."""
    host.plan(1, {0: 50_000}, {0: 20_000})
    host.wait(19_500)
    host.board.lib.board_flip_open(host.board.handle, 5)  # for a millisecond
    host.wait(700)
    host.ping()  # makes it run
    up = 20_500 + host.limits.dead_us
    assert host.wait(100_000) == [(19_500, V5), (20_500, 0), (up, V0), (70_000, 0)]
    assert host.ping().faults == 0


def test_nothing_is_continued_against_an_opposite_that_is_open_by_mistake(new_host):
    host = new_host(dead_us=0)
    host.plan(1, {0: 50_000})
    host.wait(50_000)
    host.board.lib.board_flip_open(host.board.handle, 5)
    host.plan(2, {0: 50_000})
    rested = 50_000 + host.limits.min_off_us
    assert host.wait(100_000) == [(0, V0), (50_000, 0), (rested, V0), (100_000, 0)]


def test_an_on_time_of_a_microsecond_for_a_valve_that_is_not_there(new_host):
    host = new_host(valve_count=2, opposing=(2, 1, 0, 0, 0, 0, 0, 0))
    assert host.plan(1, {2: 1}).result == Result.NO_SUCH_VALVE


@pytest.mark.parametrize(
    ("opposing", "count"),
    [
        ((0, 1, 0, 0, 0, 0, 0, 0), 8),  # one-sided, the other way round
        ((4, 0, 1, 0, 0, 0, 0, 0), 2),  # a pair, but one of it is not there
    ],
)
def test_more_limits_that_contradict_each_other(new_host, opposing, count):
    host = new_host(armed=False, opposing=opposing, valve_count=count)
    assert host.ping().state == State.BOOT


# Supply


@pytest.mark.parametrize("patience", [0, 1_999])
def test_a_supply_that_is_well_again_when_the_board_looks_trips_nothing(new_host, patience):
    host = new_host(undervoltage_us=patience)
    host.board.sense(host.limits.undervoltage_mv, 0)
    host.wait(10_000)
    assert host.ping().state == State.ARMED
    if patience:
        host.board.sense(host.limits.undervoltage_mv - 1, 0)
        host.board.skip(patience + 1)
        host.board.sense(host.limits.undervoltage_mv, 0)
    assert host.ping().faults == 0
    host.board.sense(host.limits.undervoltage_mv - 1, 0)
    host.wait(patience)
    assert host.ping().faults == Fault.UNDERVOLTAGE


def test_undervoltage_in_safe_is_no_fault_yet(new_host):
    host = new_host(armed=False)
    host.board.sense(host.limits.undervoltage_mv - 1, 0)
    host.wait(100_000)
    assert host.ping().faults == 0


def test_a_low_supply_does_not_put_the_watchdog_off(host):
    host.plan(1, {0: 300_000})
    host.wait(host.limits.watchdog_us - 1_500)
    host.board.sense(host.limits.undervoltage_mv - 1, 0)
    assert host.wait(10_000) == [(0, V0), (host.limits.watchdog_us, 0)]
    assert host.ping().faults == Fault.WATCHDOG


def test_acks_have_the_result_of_their_own_frame(host):
    host.listen()
    plans = [cmd(host, 1, {0: 50_000}), cmd(host, 2, {0: 50_000, 5: 50_000})]
    host.board.feed(b"".join(encode_message(m, 50 + n, 0) for n, m in enumerate(plans)))
    answers = [m for m in host.listen() if isinstance(m, Ack)]
    assert [(m.seq, m.result) for m in answers] == [(50, Result.OK), (51, Result.OPPOSING)]
