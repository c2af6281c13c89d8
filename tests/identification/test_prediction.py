"""`predict` is the plant, without noise, from any state."""

import numpy as np
import pytest
from msgspec import structs

import testbed
from sim_twin.plant import Plant
from testbed.core.types import Pose, ValveCommand
from testbed.core.vehicle import Tolerance
from testbed.identification.prediction import Valves, Wrenches, predict, pulses, shares

PERIOD = 0.1


@pytest.fixture(scope="module")
def exact(floater):
    return structs.replace(floater, tolerance=Tolerance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def test_it_flies_as_the_plant_does(exact, table):
    plant = Plant({"a": exact}, {"a": Pose(0.1, -0.2, 0.3)}, table, {}, 0)
    rng = np.random.default_rng(1)
    share = np.where(rng.random((20, 8)) < 0.3, rng.uniform(0.3, 0.8, (20, 8)).round(3), 0.0)
    for k in range(20):
        on = tuple(round(1e5 * one) for one in share[k])
        plant.boards["a"].apply(ValveCommand(k, PERIOD * k, PERIOD * (k + 1), on, (0,) * 8))
        plant.advance(PERIOD * (k + 1))
    inputs = pulses(PERIOD * np.arange(20), share, PERIOD)
    end = predict(exact, table, inputs, [0.1, -0.2, 0.3, 0.0, 0.0, 0.0], [0.0, 2.0])[-1]
    np.testing.assert_allclose(end, plant.x[0], rtol=0.0, atol=1e-9)


def test_a_state_on_the_way_is_a_start(exact, table):
    inputs = pulses(PERIOD * np.arange(30), np.eye(8)[np.arange(30) % 8] * 0.5, PERIOD)
    whole = predict(exact, table, inputs, np.zeros(6), [0.0, 1.33, 3.0])
    rest = predict(exact, table, inputs, whole[1], [1.33, 3.0])
    np.testing.assert_allclose(rest[-1], whole[-1], atol=1e-5)  # the gas of 1.33 s


def test_delays_are_smooth(exact):
    inputs = Valves(np.array([0.1]), np.array([0.3]), np.array([4]))

    def end(delay):
        late = structs.replace(exact, command_delay_s=delay)
        return predict(late, None, inputs, np.zeros(6), [0.0, 1.0])[-1, 0]

    nudge = 1e-7
    slope = (end(0.02 + nudge) - end(0.02)) / nudge
    assert slope == pytest.approx(-0.2 * 0.6 / exact.mass, rel=1e-3)


def test_a_force_of_the_table_does_not_turn_with_the_body(exact):
    t = np.arange(0.0, 2.0, 0.1)
    force = np.tile([0.5, 0.0, 0.0], (20, 1))
    turning = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    end = predict(exact, None, Wrenches(t, force, in_table=True), turning, [0.0, 2.0])[-1]
    still = predict(exact, None, Wrenches(t, force), np.zeros(6), [0.0, 2.0])[-1]
    np.testing.assert_allclose(end[[0, 1]], still[[0, 1]], atol=1e-5)


@pytest.mark.parametrize(
    ("x0", "times"),
    [([0.0] * 5, [0.0, 1.0]), ([0.0] * 6, [1.0, 0.0]), ([np.nan] * 6, [0.0, 1.0]), ([0.0] * 6, [])],
)
def test_bad_input_is_refused(exact, x0, times):
    none = Valves(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))
    with pytest.raises(testbed.TestbedError, match="predict"):
        predict(exact, None, none, x0, times)


PULSE = Valves(np.array([0.1]), np.array([0.3]), np.array([4]))


@pytest.mark.parametrize(
    ("inputs", "where", "expected"),
    [
        (Valves([0.1], [0.3], [8]), "inputs.jet", "jet indices 0 to 7"),
        (Valves([0.1], [0.3], [-1]), "inputs.jet", "jet indices 0 to 7"),
        (Valves([0.1], [0.3], [-9]), "inputs.jet", "jet indices 0 to 7"),
        (Valves([0.1], [0.3], [0.5]), "inputs.jet", "whole numbers"),
        (Valves([0.1, 0.2], [0.3], [4]), "inputs.down", "shape (2,)"),
        (Valves([0.1], [0.3], [4, 5]), "inputs.jet", "shape (1,)"),
        (Valves([0.3], [0.1], [4]), "inputs.down", "up, then down"),
        (Valves([np.nan], [0.3], [4]), "inputs.up", "finite"),
        (Valves(["0.1"], [0.3], [4]), "inputs.up", "finite numbers"),
        (Valves([0.1], [0.3], [4], [2.0]), "inputs.share", "0 to 1"),
        (Valves([0.1], [0.3], [4], [0.5, 0.5]), "inputs.share", "shape (1,)"),
        (Valves([0.1], [0.1], [4], [0.5]), "inputs.down", "up, then down"),
        (Wrenches([0.0, 1.0], [[1.0, 0.0, 0.0]]), "inputs.wrench", "shape (2, 3)"),
        (Wrenches([0.0], [1.0, 0.0, 0.0]), "inputs.wrench", "shape (1, 3)"),
        (Wrenches([0.0, 1.0], [[1.0, 0.0, 0.0], [1.0]]), "inputs.wrench", "shape (2, 3)"),
        (Wrenches([0.0], [[np.nan, 0.0, 0.0]]), "inputs.wrench", "finite"),
        (Wrenches([1.0, 1.0], np.zeros((2, 3))), "inputs.t", "1 us apart"),
        (None, "inputs", "testbed.Valves"),
        (([0.1], [0.3], [4]), "inputs", "testbed.Valves"),
    ],
)
def test_bad_commands_are_refused(exact, inputs, where, expected):
    with pytest.raises(testbed.TestbedError) as caught:
        predict(exact, None, inputs, np.zeros(6), [0.0, 1.0])
    assert caught.value.where == f"testbed.predict, {where}"
    assert expected in caught.value.expected
    assert caught.value.found


def test_what_is_no_vehicle_table_or_state_is_refused(exact):
    hold, times = testbed.load("hold"), [0.0, 1.0]
    for wrong in ("generic_8jet", hold, hold.vehicles["sat1"]):
        with pytest.raises(testbed.TestbedError, match=r'vehicles\["sat1"\]\.model'):
            predict(wrong, None, PULSE, np.zeros(6), times)
    with pytest.raises(testbed.TestbedError, match=r"the table of an experiment, or None"):
        predict(exact, "marble_6m", PULSE, np.zeros(6), times)
    for x0 in ("abc", None, [[0.0] * 6], ["0"] * 6, [0.0] * 5 + [[0.0]]):
        with pytest.raises(testbed.TestbedError, match=r"x0\n.*shape \(6,\)"):
            predict(exact, None, PULSE, x0, times)
    with pytest.raises(testbed.TestbedError, match=r"times\n.*shape \(n,\)"):
        predict(exact, None, PULSE, np.zeros(6), 3.0)


def test_lists_whole_floats_and_unsorted_rows_give_the_same_motion(exact):
    def end(inputs):
        return predict(exact, None, inputs, np.zeros(6), [0.0, 1.0, 2.5])

    np.testing.assert_array_equal(end(Valves([0.1], [0.3], [4.0])), end(PULSE))
    two = Valves(np.array([0.1, 0.9]), np.array([0.3, 1.2]), np.array([4, 1]))
    turned = Valves([0.9, 0.1], [1.2, 0.3], [1, 4])
    np.testing.assert_array_equal(end(turned), end(two))
    push = Wrenches(np.array([0.0, 1.0]), np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    turned = Wrenches([1, 0], [[0, 0, 0], [0.5, 0, 0]])
    np.testing.assert_array_equal(end(turned), end(push))
    none = Wrenches([], np.zeros((0, 3)))
    np.testing.assert_array_equal(end(none), end(Valves([], [], [])))


def test_it_is_part_of_the_public_api():
    assert testbed.predict is predict
    assert testbed.Valves is Valves


def test_pulses_at_unknown_times_give_the_same_mean_push(exact):
    t, share = PERIOD * np.arange(20), np.full((20, 8), [0.4, 0, 0, 0, 0, 0, 0, 0])
    both = [
        predict(exact, None, made(t, share, PERIOD), np.zeros(6), [0.0, 2.5])[-1]
        for made in (pulses, shares)
    ]
    np.testing.assert_allclose(both[1][3:], both[0][3:], rtol=1e-2)
    np.testing.assert_allclose(both[1][:3], both[0][:3], rtol=4e-2)


def test_a_valve_that_closes_early_opens_for_a_smaller_share(exact):
    early = structs.replace(exact.valve, close_delay_s=exact.valve.open_delay_s - 0.01)
    t, share = PERIOD * np.arange(20), np.full((20, 8), [0.4, 0, 0, 0, 0, 0, 0, 0])
    ends = [
        predict(structs.replace(exact, valve=valve), None, shares(t, share, PERIOD), np.zeros(6),
                [0.0, 2.5])[-1]
        for valve in (exact.valve, early)
    ]  # fmt: skip
    assert ends[1][5] / ends[0][5] == pytest.approx(0.75, rel=1e-2)
