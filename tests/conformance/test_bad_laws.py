"""A law with a planted fault is caught, by the check that is for it."""

import numpy as np
import pytest

from controllers.catalogue import make_law
from controllers.pd import PdParams
from springs import Springs
from testbed.conformance import LawConformance, check_law
from testbed.conformance.check import NotConformingError, run_all
from testbed.core.error import TestbedError

KEPT = []
rng = np.random.default_rng(7)


class Law:
    """A law that conforms."""

    def force(self, own, neighbours, world, t):
        return 0.1 * (world.goal.p - own.p)


class Writes(Law):
    def force(self, own, neighbours, world, t):
        world.goal.p[0] += 0.5
        return super().force(own, neighbours, world, t)


class WritesItsState(Law):
    def initial(self, own, neighbours, world):
        return np.zeros(2)

    def rate(self, law_state, own, neighbours, world, t):
        law_state += 1.0
        return self.force(own, neighbours, world, t), np.zeros(2)


class Counts(Law):
    asked = 0

    def force(self, own, neighbours, world, t):
        self.asked += 1
        return super().force(own, neighbours, world, t) + 1e-9 * self.asked


class Draws(Law):
    def force(self, own, neighbours, world, t):
        return 1e-6 * rng.standard_normal(len(own.p))


class KeepsOutside(Law):
    def __init__(self):
        KEPT.append(self)
        self.number = len(KEPT)

    def force(self, own, neighbours, world, t):
        return super().force(own, neighbours, world, t) + 1e-9 * self.number


class TakesTheFirstNeighbour(Law):
    def force(self, own, neighbours, world, t):
        return neighbours.p[0] - own.p


class DividesByTheDistance(Law):
    def force(self, own, neighbours, world, t):
        with np.errstate(all="ignore"):
            return (world.goal.p - own.p) / np.linalg.norm(world.goal.p - own.p)


class IsFlat(Law):
    def force(self, own, neighbours, world, t):
        return np.zeros(2)


class Whole:
    """A law with a `propagate` of its own, which says too much."""

    message_size = 0

    def initial(self, own, neighbours, world):
        return np.zeros(0)

    def rate(self, law_state, own, neighbours, world, t):
        return np.zeros(2), law_state

    def propagate(self, law_state, own, neighbours, world, t, duration, steps):
        from testbed.core.law import Ahead

        return Ahead(law_state, own.p, own.v, np.zeros(2), np.zeros(3))


class WholeWrites(Whole):
    def rate(self, law_state, own, neighbours, world, t):
        world.goal.p[0] += 0.5
        return np.zeros(2), law_state


class NoForce:
    pass


BAD = {  # law: (the check, what it says)
    Writes: ("inputs_are_not_written", "read-only"),
    WritesItsState: ("inputs_are_not_written", "read-only"),
    WholeWrites: ("inputs_are_not_written", "one was written"),
    Counts: ("same_question_same_answer", "memory is the law's state"),
    Draws: ("same_question_same_answer", "memory is the law's state"),
    KeepsOutside: ("two_laws_are_alike", "nothing outside it is kept"),
    TakesTheFirstNeighbour: ("finite_numbers", "IndexError"),
    DividesByTheDistance: ("finite_numbers", "nan"),
    Whole: ("shapes", "`message` of its `Ahead`"),
    NoForce: ("shapes", "NoForce with neither"),
}


def suite(made, dimensions=(2,)):
    one = type("Suite", (LawConformance,), {"make": made, "dimensions": dimensions})
    return one()


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.__name__)
def test_it_is_caught(bad):
    check, words = BAD[bad]
    with pytest.raises(NotConformingError, match=words):
        getattr(suite(bad), f"test_{check}")()
    with pytest.raises(NotConformingError):
        check_law(bad)


def test_a_law_for_the_table_only_is_caught_in_orbit():
    run_all(suite(IsFlat))
    with pytest.raises(NotConformingError, match=r"shape \(3,\)"):
        run_all(suite(IsFlat, (3,)))


def test_good_ones_pass():
    check_law(Law)
    check_law(Springs, {"push": 0.3}, (2, 3))


def test_a_law_of_the_project_conforms():
    def pd(names: list[str] = ()):
        return make_law(PdParams(), names)

    check_law(pd)


@pytest.mark.parametrize(
    ("wrong", "where"),
    [
        ({"dimensions": 2}, "dimensions"),
        ({"dimensions": ()}, "dimensions"),
        ({"dimensions": (4,)}, "dimensions"),
        ({"dimensions": "23"}, "dimensions"),
        ({"dimensions": ([2],)}, "dimensions"),
        ({"parameters": [0.3]}, "parameters"),
    ],
)
def test_wrong_arguments_say_what_was_expected(wrong, where):
    with pytest.raises(TestbedError) as caught:
        check_law(Springs, **wrong)
    assert caught.value.where == f"check_law, {where}"
    assert caught.value.expected


def test_parameters_that_do_not_fit_are_named():
    with pytest.raises(NotConformingError, match="stiffness"):
        check_law(Springs, {"stiffness": -1.0})
