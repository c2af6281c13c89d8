"""The twin as a whole: one seed, one history, however it is asked for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sim_twin.radio import listen
from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.core.types import Accel, LawMessage, Pose, State, Twist

# not on the seam between the slabs, y = 0, where the tilt has a kink
STARTS = {"a": Pose(-1.0, 0.3, 0.1), "b": Pose(1.0, 0.5, 2.0), "c": Pose(0.0, -2.0, -1.0)}
SECONDS = 3


@pytest.fixture(scope="module")
def make_twin(shipped_vehicle, shipped_table):
    def make(names="ab", seed=0, listeners="abc"):
        fleet = dict.fromkeys(names, shipped_vehicle)
        starts = {n: STARTS[n] for n in names}
        return Twin(fleet, starts, shipped_table, {}, seed, listeners=listeners)

    return make


def state_of(t, x):
    return State(t, Pose(x, 0, 0), Twist(0, 0, 0), Accel(0, 0, 0), pose_age=0.0, rejected=0)


@pytest.fixture(scope="module")
def fly(make_plan):
    """Fly a plan in every period, stopping at the `stops` in between, too."""

    def run(twin, stops=(), seconds=SECONDS):
        stops, heard = np.sort(np.asarray(stops)), []
        for k in range(10 * seconds):
            start, end = 0.1 * k, 0.1 * (k + 1)
            for name in twin.names:
                jets = np.random.default_rng([k, ord(name)]).choice(8, 3, replace=False)
                plan = make_plan(start, dict.fromkeys(jets.tolist(), (0.015, 0.07)))
                TwinThrusters(twin, name).apply(plan)
                TwinVehicleLink(twin, name).publish(state_of(start, k))
            for t in stops[(stops > start) & (stops < end)]:
                twin.wait_until(t)
            twin.wait_until(end)
            heard += [(n, s) for n in twin.names for s in TwinPoses(twin, n).samples()]
            heard += [(n, TwinHostLink(twin, n).own()) for n in twin.names]
            heard += [(n, TwinVehicleLink(twin, n).neighbours()) for n in twin.names]
        return heard

    return run


def test_the_same_seed_gives_the_same_history_bit_for_bit(make_twin, fly):
    first, again = make_twin(seed=4), make_twin(seed=4)
    assert fly(first) == fly(again)
    assert (first.plant.x == again.plant.x).all()
    assert (first.plant.used == again.plant.used).all()
    assert first.health("a") == again.health("a")


def test_another_seed_gives_another_history(make_twin, fly):
    first, other = make_twin(seed=4), make_twin(seed=5)
    assert fly(first) != fly(other)
    assert (first.plant.x != other.plant.x).all()


def test_one_vehicle_more_changes_nothing_for_the_others(make_twin, fly):
    few, many = make_twin("ab"), make_twin("cab")
    # without what is heard of neighbours, of which there is one more
    heard = [e for e in fly(few) if not isinstance(e[1], dict)]
    also = [e for e in fly(many) if e[0] != "c" and not isinstance(e[1], dict)]
    assert heard == also
    assert (few.plant.x == many.plant.x[1:]).all()


def test_waiting_for_now_or_the_past_does_nothing(make_twin, fly):
    twin, undisturbed = make_twin(), make_twin()
    fly(twin)
    fly(undisturbed)
    for t in (twin.now, twin.now - 1.0, 0.0, -1.0):
        twin.wait_until(t)
        assert twin.now == undisturbed.now
    assert (twin.plant.x == undisturbed.plant.x).all()
    assert twin.seen_at == undisturbed.seen_at
    twin.wait_until(3.5)
    undisturbed.wait_until(3.5)
    assert TwinPoses(twin, "a").samples() == TwinPoses(undisturbed, "a").samples()


def test_frames_come_at_the_rate_of_the_cameras(make_twin):
    twin = make_twin()
    for t in np.sort(np.random.default_rng(2).uniform(0.0, 2.0, 300)):
        twin.wait_until(t)
        assert twin.now == t
    assert_allclose(np.diff(twin.seen_at), 0.01, atol=1e-12)
    assert 0.0 <= twin.seen_at[0] < 0.01
    assert twin.now - 0.01 < twin.seen_at[-1] <= twin.now
    assert len(np.concatenate(twin.seen)) == len(twin.seen_at)


@pytest.mark.parametrize("count", [30, 3000])
def test_history_does_not_depend_on_where_one_stops(make_twin, fly, count):
    straight, stopping = make_twin(), make_twin()
    fly(straight)
    fly(stopping, np.random.default_rng(3).integers(0, SECONDS * 10**6, count) * 1e-6)
    assert_allclose(stopping.plant.x, straight.plant.x, rtol=0, atol=1e-12)
    assert_allclose(stopping.plant.used, straight.plant.used, rtol=1e-12)
    assert stopping.seen_at == straight.seen_at
    assert_allclose(np.concatenate(stopping.seen), np.concatenate(straight.seen), atol=1e-12)


def test_nor_on_stops_between_two_nanoseconds(make_twin, fly):
    straight, stopping = make_twin(), make_twin()
    fly(straight)
    fly(stopping, np.random.default_rng(3).uniform(0.0, SECONDS, 300))
    assert_allclose(stopping.plant.x, straight.plant.x, rtol=0, atol=1e-12)


def test_health_follows_the_gas(make_twin, fly, shipped_vehicle):
    twin, air = make_twin(), shipped_vehicle.air
    full = twin.health("b")
    assert (full.supply_pressure, full.tank_pressure) == (air.set_pressure, air.tank_pressure)
    fly(twin)
    left = air.gas - twin.plant.used[1]
    assert twin.health("b").t == twin.now
    assert twin.health("b").tank_pressure == pytest.approx(air.tank_pressure * left / air.gas)


def test_links_lead_where_they_say(make_twin):
    twin = make_twin("abc")
    for x, name in enumerate("abc"):
        for _ in range(20):  # some get lost
            TwinVehicleLink(twin, name).publish(state_of(0.0, float(x)))
    twin.wait_until(1.0)
    for x, name in enumerate("abc"):
        others = {n: float(k) for k, n in enumerate("abc") if n != name}
        for link in (TwinVehicleLink(twin, name), TwinHostLink(twin, name)):
            assert {n: s.pose.x for n, s in link.neighbours().items()} == others
        own = TwinHostLink(twin, name).own()
        assert own is not None
        assert own.pose.x == x
        assert TwinVehicleLink(twin, name).setpoint() is None


def test_every_link_has_losses_of_its_own(make_vehicle, make_table):
    names = "abc"
    table = make_table(link={"loss": 0.5, "jitter_s": 0.0})
    fleet = dict.fromkeys(names, make_vehicle())
    twin = Twin(fleet, STARTS, table, {}, seed=1, listeners=names)
    pairs = [(a, b) for a in (*names, "host") for b in (*names, "host") if a != b]
    radio, arrived = twin.states, []
    for pair in pairs:
        row, heard = radio.rows([pair]), []
        for k in range(64):
            radio.send(row, float(k), np.array([float(k)]))
            listen(radio.links, k + 0.5)
            newest = radio.newest(*pair)
            heard.append(newest is not None and newest[0] == k)
        arrived.append(heard)
    assert len(pairs) == 12
    assert len({tuple(pattern) for pattern in arrived}) == 12


def test_only_listeners_hear_their_neighbours(make_twin):
    twin = make_twin("abc", listeners="b")
    for name in "abc":
        for _ in range(20):
            TwinVehicleLink(twin, name).publish(state_of(0.0, 0.0))
    twin.wait_until(1.0)
    assert list(TwinVehicleLink(twin, "b").neighbours()) == ["a", "c"]
    assert TwinVehicleLink(twin, "a").neighbours() == {}
    assert set(TwinHostLink(twin, "a").neighbours()) == {"b", "c"}


def test_only_who_is_in_range_is_heard(make_vehicle, make_table):
    table = make_table(link={"range_m": 1.5, "loss": 0.0, "burst_loss": 0.0}, size=(20.0, 20.0))
    starts = {"a": Pose(0.0, 0.0, 0.0), "b": Pose(1.0, 0.0, 0.0), "c": Pose(2.0, 0.0, 0.0)}
    twin = Twin(dict.fromkeys("abc", make_vehicle()), starts, table, {}, seed=1, listeners="abc")
    for name in "abc":
        TwinVehicleLink(twin, name).publish(state_of(0.0, 0.0))
    twin.wait_until(0.1)

    def heard():
        return {n: list(TwinVehicleLink(twin, n).neighbours()) for n in "abc"}

    assert heard() == {"a": ["b"], "b": ["a", "c"], "c": ["b"]}
    twin.plant.x[2, 0] = 9.0  # who has gone is not a neighbour any more, and no fault either
    twin.wait_until(0.2)
    assert heard() == {"a": ["b"], "b": ["a"], "c": []}
    assert set(TwinHostLink(twin, "a").neighbours()) == {
        "b",
        "c",
    }  # the host has a radio of its own


def test_laws_on_the_host_hear_what_was_said_before_this_tick(make_twin):
    twin = make_twin()
    a, b = TwinHostLink(twin, "a"), TwinHostLink(twin, "b")
    for k in range(3):
        twin.wait_until(0.1 * k)
        a.broadcast(LawMessage(0.1 * k, (float(k),)))
        # whoever speaks first in a tick: both hear the tick before
        expected = {} if k == 0 else {"a": LawMessage(0.1 * (k - 1), (k - 1.0,))}
        assert b.messages() == expected
        assert a.messages() == {}


def test_laws_on_board_hear_each_other_over_the_air(make_twin):
    twin = make_twin(listeners=["b"])
    TwinVehicleLink(twin, "a").broadcast(LawMessage(0.1, (1.0, 2.0)))
    twin.wait_until(1.0)
    assert TwinVehicleLink(twin, "b").messages() == {"a": LawMessage(0.1, (1.0, 2.0))}
    assert TwinVehicleLink(twin, "a").messages() == {}
