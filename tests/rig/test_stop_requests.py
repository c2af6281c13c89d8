"""How often an operator has said stop, however many ways it came."""

import pytest

from testbed.rig.wired.stop_requests import AGAIN_NS, SHARED, StopCount, StopRequests


def heard(*times):
    now = iter(times)
    asked = StopRequests(lambda: next(now))
    return [asked.count() for _ in times]


def test_one_stop_comes_by_several_ways():
    assert heard(7, 8, 7 + AGAIN_NS) == [1, 1, 1]


def test_a_stop_that_comes_later_is_the_second():
    assert heard(7, 8 + AGAIN_NS, 9 + AGAIN_NS) == [1, 2, 2]


def test_copies_of_one_stop_count_once_however_late():
    now = iter((0, 5 * AGAIN_NS, 9 * AGAIN_NS))
    asked = StopRequests(lambda: next(now))
    assert [asked.count(one) for one in (b"a", b"a", b"b", b"a", b"b")] == [1, 1, 2, 2, 2]


@pytest.mark.parametrize("late", [1, 3 * AGAIN_NS])
def test_a_stop_that_a_vehicle_hears_first_counts_once_at_its_host(late):
    vehicle, now = StopRequests(lambda: 0), [0]
    host = StopRequests(lambda: now[0])
    assert vehicle.count(b"a") == 1
    for now[0] in (5, 10):  # every report of the vehicle has it
        host.at_least(vehicle.times, vehicle.marks)
    now[0] += late
    assert host.count(b"a") == 1  # the same press, by way of the network
    now[0] += AGAIN_NS
    assert host.count(b"b") == 2  # another press


def test_two_operators_at_the_same_time_count_once_also_if_both_come_late():
    vehicle, now = StopRequests(lambda: 0), [0]
    host = StopRequests(lambda: now[0])
    assert [vehicle.count(one) for one in (b"a", b"b")] == [1, 1]
    host.at_least(vehicle.times, vehicle.marks)
    now[0] = 2 * AGAIN_NS
    assert [host.count(one) for one in (b"a", b"b")] == [1, 1]


def test_the_marks_stay_small_whatever_comes():
    vehicle = StopRequests(lambda: 0)
    for k in range(100):
        vehicle.count(b"%d" % k * 3000)
    assert sum(map(len, vehicle.marks)) == 8 * SHARED


def test_one_that_says_so_is_at_once():
    asked = StopRequests(lambda: 0)
    assert asked.times == 0
    asked.insist()
    assert asked.times == 2


@pytest.mark.parametrize(("apart", "times"), [(0, 1), (AGAIN_NS, 1), (AGAIN_NS + 1, 2)])
@pytest.mark.parametrize("first", ["at the terminal", "elsewhere"])
def test_a_ctrl_c_and_a_stop_from_elsewhere_are_two_stops(first, apart, times):
    now, own = [7], [0]
    asked = StopRequests(lambda: now[0])
    stops = StopCount(lambda: own[0], asked, lambda: now[0])

    def press(where):
        own[0] += where == "at the terminal"
        if where == "elsewhere":
            asked.count(b"a")

    assert stops() == 0
    press(first)
    assert stops() == 1
    now[0] += apart
    press({"at the terminal": "elsewhere", "elsewhere": "at the terminal"}[first])
    assert [stops(), stops()] == [times, times]


def test_two_ctrl_c_are_two_stops_without_any_other():
    own, asked = [0], StopRequests(lambda: 0)
    stops = StopCount(lambda: own[0], asked, lambda: 0)
    assert [stops() for own[0] in (0, 1, 2)] == [0, 1, 2]
