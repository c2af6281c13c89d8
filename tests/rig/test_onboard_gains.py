"""A vehicle's answer to an order to fly with other gains."""

import pytest

from testbed.config import find, load
from testbed.net.commands import Retune
from testbed.rig.wired.gains import OnboardGains

SESSION = 7


class Agent:
    """Keeps the changes that it is told."""

    def __init__(self):
        self.changes = {}

    def change(self, at_s, before, after):
        self.changes[at_s] = before.controller.bandwidth, after.controller.bandwidth

    def withdraw(self, at_s):
        del self.changes[at_s]


@pytest.fixture
def agent():
    return Agent()


@pytest.fixture
def obey(agent):
    return OnboardGains(load(find("hold"), []), agent, SESSION, lambda: 5.0).obey


def test_changes_follow_each_other(agent, obey):
    assert obey(Retune(SESSION, 6.0, {"bandwidth": 0.3})) == ""
    assert obey(Retune(SESSION, 7.0, {"bandwidth": 0.4})) == ""
    assert agent.changes == {6.0: (0.2, 0.3), 7.0: (0.3, 0.4)}


def test_a_change_that_is_withdrawn_has_never_been(agent, obey):
    obey(Retune(SESSION, 6.0, {"bandwidth": 0.3}))
    assert obey(Retune(SESSION, 6.0, {})) == ""
    obey(Retune(SESSION, 7.0, {"bandwidth": 0.4}))
    assert agent.changes == {7.0: (0.2, 0.4)}


@pytest.mark.parametrize(
    ("order", "why"),
    [
        (Retune(SESSION + 1, 6.0, {"bandwidth": 0.3}), "another session"),
        (Retune(SESSION, 5.1, {"bandwidth": 0.3}), "too late"),
        (Retune(SESSION, float("nan"), {"bandwidth": 0.3}), "too late"),
        (Retune(SESSION, 6.0, {"bandwidth": -1.0}), "bandwidth > 0"),
        (Retune(SESSION, 6.0, {"mass": 1.0}), "one of: bandwidth, damping"),
    ],
)
def test_a_wrong_order_changes_nothing(agent, obey, order, why):
    assert why in obey(order)
    assert agent.changes == {}
