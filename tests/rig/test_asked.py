"""How often an operator has said stop, however many ways it came."""

from testbed.rig.wired.stop_requests import AGAIN_NS, Asked


def heard(*times):
    now = iter(times)
    asked = Asked(lambda: next(now))
    return [asked.hear() for _ in times]


def test_one_stop_comes_by_several_ways():
    assert heard(7, 8, 7 + AGAIN_NS) == [1, 1, 1]


def test_a_stop_that_comes_later_is_the_second():
    assert heard(7, 8 + AGAIN_NS, 9 + AGAIN_NS) == [1, 2, 2]


def test_copies_of_one_stop_count_once_however_late():
    now = iter((0, 5 * AGAIN_NS, 9 * AGAIN_NS))
    asked = Asked(lambda: next(now))
    assert [asked.hear(one) for one in (b"a", b"a", b"b", b"a", b"b")] == [1, 1, 2, 2, 2]


def test_one_that_says_so_is_at_once():
    asked = Asked(lambda: 0)
    assert asked.times == 0
    asked.insist()
    assert asked.times == 2
