"""Jets that can give every wrench are told from those that cannot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.config import find, load
from testbed.config.error import ConfigError
from testbed.config.hardware import push_everywhere
from testbed.core.jets import effect_matrix
from testbed.core.vehicle import Jet

CENTRE, RADIUS = (0.0, 0.0), 0.2
EIGHT = load(find("hold")).vehicles["sat1"].model.jets


def test_valve_times_that_just_meet_a_limit_are_not_refused_by_rounding():
    # 0.04 + 0.01 - 0.04 is more than 0.01 by 2e-18
    times = {"open_delay_s": 0.04, "close_delay_s": 0.04, "close_ramp_s": 0.01, "min_off_s": 0.01}
    load(find("hold"), [f"vehicles.sat1.model.valve.{key}={value}" for key, value in times.items()])


def test_valves_may_be_later_than_a_jet_period():
    times = {"open_delay_s": 0.15, "close_delay_s": 0.14}
    load(find("hold"), [f"vehicles.sat1.model.valve.{key}={value}" for key, value in times.items()])


def test_a_pulse_that_the_twin_would_forget_while_it_flows_is_refused():
    """The twin remembers four pulses of a jet; the oldest flows for up to three periods more."""
    times = {"valve.open_delay_s": 0.19, "valve.close_delay_s": 0.2, "valve.min_off_s": 0.1}
    longest = {**times, "valve.close_ramp_s": 0.05, "valve.open_ramp_s": 0.05}
    changes = [f"vehicles.sat1.model.{key}={value}" for key, value in longest.items()]
    load(find("hold"), [*changes, "vehicles.sat1.model.command_delay_s=0.05"])
    with pytest.raises(ConfigError) as refused:
        load(find("hold"), [*changes, "vehicles.sat1.model.command_delay_s=0.051"])
    assert refused.value.where.endswith("model.valve.close_delay_s=0.2")
    assert "at most 0.199 s" in str(refused.value)
    with pytest.raises(ConfigError):  # and so it is of valves that are later than in the file
        load(find("hold"), [*changes, "table.spread.delay_s=0.02"])


def jet(x: float, y: float, direction: float, thrust: float) -> Jet:
    push = (float(np.cos(direction)), float(np.sin(direction)))
    return Jet((x * RADIUS, y * RADIUS), push, thrust)


def test_the_shipped_eight():
    assert push_everywhere(EIGHT, CENTRE, RADIUS)


@pytest.mark.parametrize("lost", range(8))
def test_seven_of_the_eight_are_enough(lost):
    assert push_everywhere([j for i, j in enumerate(EIGHT) if i != lost], CENTRE, RADIUS)


@pytest.mark.parametrize("pair", [(0, 1), (2, 3), (4, 5), (6, 7)])
def test_without_a_side_there_is_a_push_that_none_gives(pair):
    assert not push_everywhere([j for i, j in enumerate(EIGHT) if i not in pair], CENTRE, RADIUS)


def test_all_ways_but_one_way_round_is_not_enough():
    turns = effect_matrix(EIGHT)[2]
    kept = [j for j, turn in zip(EIGHT, turns, strict=True) if turn > 0.0]
    assert len(kept) == 4
    assert not push_everywhere(kept, CENTRE, RADIUS)


def test_jets_through_the_centre_of_mass_cannot_turn():
    around = np.arange(8) * np.pi / 4
    jets = [jet(0.9 * np.cos(a), 0.9 * np.sin(a), a + np.pi, 0.5) for a in around]
    assert not push_everywhere(jets, CENTRE, RADIUS)
    assert not push_everywhere([], CENTRE, RADIUS)


def directions(count: int) -> np.ndarray:
    """Points on the unit sphere, evenly spread (Fibonacci lattice), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


SPHERE = directions(20_000)  # no point of it is further than 0.03 from one of these


@given(
    st.lists(
        st.tuples(
            st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(0.0, 6.3), st.floats(0.3, 1.0)
        ),
        min_size=3,
        max_size=9,
    )
)
def test_every_wrench_has_a_jet_that_helps(rows):
    jets = [jet(*row) for row in rows]
    thrust = max(j.thrust for j in jets)
    effect = effect_matrix(jets).T / (thrust * np.array([1.0, 1.0, RADIUS]))
    help_in_the_worst_direction = (SPHERE @ effect.T).max(axis=1).min()
    if push_everywhere(jets, CENTRE, RADIUS):
        assert help_in_the_worst_direction > 0.0
    else:
        assert help_in_the_worst_direction < 0.001 + 0.03 * np.linalg.norm(effect, axis=1).max()
