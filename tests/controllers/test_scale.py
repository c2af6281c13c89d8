"""A law in a paper's units, flown on the table: the same flight in other units."""

import msgspec
import numpy as np
import pytest

from controllers.catalogue import make_law
from controllers.pd import PdParams, pd
from controllers.plain_law import propagate_plain
from controllers.scale import Scale, Scaled
from controllers.smc import SmcParams, smc
from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.law import Body, Discs, Goal, Neighbours, World, silent

ZHANG = Scale(length=62.5, time=10.0, mass=1.0)
LAWS = {
    "sotsmc": lambda: sotsmc(SotsmcParams(), 2),
    "smc": lambda: smc(SmcParams(), 2),
    "pd": lambda: pd(PdParams(bandwidth=0.01)),
}
MASS = 12.5  # of the table's vehicle [kg]
STEPS = 1000


def in_paper_units(own, neighbours, world, scale):
    """The table's scene in a world `length` times as large and `time` times as slow."""
    length, time = scale.length, scale.time
    speed, accel, jerk = length / time, length / time**2, length / time**3
    mass = scale.mass or own.mass

    def discs(group):
        return Discs(length * group.p, speed * group.v, length * group.radius)

    goal = world.goal
    return (
        Body(
            length * own.p,
            speed * own.v,
            mass,
            accel * own.disturbance,
            jerk * own.disturbance_rate,
            accel * mass * own.max_force / own.mass,
        ),
        Neighbours(
            *discs(neighbours),
            neighbours.vehicle_index,
            neighbours.message,
            time * neighbours.message_t,
        ),
        World(
            Goal(length * goal.p, speed * goal.v, accel * goal.a, jerk * goal.jerk),
            discs(world.obstacles),
        ),
    )


@pytest.fixture
def table_scene():
    """Past an obstacle in 20 s, everything moves a little."""
    own = Body(
        np.array([0.1, -1.4]),
        np.array([0.01, 0.02]),
        MASS,
        np.array([1e-3, -2e-3]),
        np.array([1e-5, 2e-5]),
        0.5,
    )
    goal = Goal(np.array([0.17, 1.9]), np.array([1e-3, 0.0]), np.zeros(2), np.zeros(2))
    obstacles = Discs(np.array([[0.6, -0.2]]), np.array([[0.0, -0.01]]), np.array([0.8]))
    others = Discs(np.array([[-0.9, -1.1]]), np.array([[0.01, 0.0]]), np.array([0.6]))
    return own, silent(others), World(goal, obstacles)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("scale", [ZHANG, Scale(0.5, 3.0, 20.0), Scale(2.0, 0.5)])
def test_a_scaled_law_is_the_law_in_the_papers_units(name, scale, table_scene):
    law, scaled = LAWS[name](), Scaled(LAWS[name](), scale)
    paper_scene = in_paper_units(*table_scene, scale)
    state = law.initial(*paper_scene)
    assert (scaled.initial(*table_scene) == state).all()

    # its rate, integrated here on the table, against the law integrated in the paper's world
    table = propagate_plain(scaled, state, *table_scene, 0.0, 20.0, STEPS)
    paper = law.propagate(state, *paper_scene, 0.0, 20.0 * scale.time, STEPS)

    assert np.linalg.norm(table.p - table_scene[0].p) > 0.05
    assert scale.length * table.p == pytest.approx(paper.p, rel=1e-7)
    assert scale.length / scale.time * table.v == pytest.approx(paper.v, rel=1e-7)
    assert table.law_state == pytest.approx(paper.law_state, rel=1e-6, abs=1e-12)
    paper_accel = paper.mean_force / (scale.mass or MASS)
    assert table.mean_force / MASS * scale.length / scale.time**2 == pytest.approx(
        paper_accel, rel=1e-6
    )


@pytest.mark.parametrize("name", LAWS)
def test_both_ways_to_fly_a_scaled_law_agree(name, table_scene):
    scaled = Scaled(LAWS[name](), ZHANG)
    state = scaled.initial(*table_scene)
    one = scaled.propagate(state, *table_scene, 0.0, 20.0, STEPS)
    other = propagate_plain(scaled, state, *table_scene, 0.0, 20.0, STEPS)
    for a, b in zip(one, other, strict=True):
        assert a == pytest.approx(b, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_scale_one_changes_no_bit(name, table_scene):
    law = LAWS[name]()
    state = law.initial(*table_scene)
    bare = law.propagate(state, *table_scene, 0.0, 1.0, 100)
    scaled = Scaled(law, Scale()).propagate(state, *table_scene, 0.0, 1.0, 100)
    for a, b in zip(bare, scaled, strict=True):
        assert (a == b).all()


def test_zhangs_scale_by_hand():
    # 50 m <-> 0.8 m, 1000 s <-> 100 s: 1 m/s^2 there is 1.6 m/s^2 here, 20 N on 12.5 kg
    law = Scaled(pd(PdParams(bandwidth=1.0)), ZHANG)
    still, nothing = np.zeros(2), Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    own = Body(np.array([0.8, 0.0]), still, MASS, still, still, 1e9)
    world = World(Goal(still, still, still, still), nothing)
    force, _ = law.rate(np.zeros(0), own, silent(nothing), world, 0.0)
    assert force == pytest.approx([-50.0 * 1.6 * MASS, 0.0])


@pytest.mark.parametrize(
    ("params", "state"), [(SotsmcParams(scale=ZHANG), 3), (SmcParams(), 0), (PdParams(), 0)]
)
def test_the_catalogue_makes_every_law(params, state, table_scene):
    law = make_law(params)
    assert law.initial(*table_scene).shape == (state,)
    assert np.isfinite(law.rate(law.initial(*table_scene), *table_scene, 0.0)[0]).all()


def test_the_catalogue_applies_the_scale(table_scene):
    params = SotsmcParams(scale=ZHANG)
    one, other = make_law(params), Scaled(LAWS["sotsmc"](), ZHANG)
    state = one.initial(*table_scene)
    for a, b in zip(
        one.propagate(state, *table_scene, 0.0, 0.5, 50),
        other.propagate(state, *table_scene, 0.0, 0.5, 50),
        strict=True,
    ):
        assert (a == b).all()


def test_too_few_gains_for_the_dimensions_are_refused():
    with pytest.raises(ValueError, match="expected 3 diagonal elements"):
        make_law(SmcParams(k=(0.5, 0.3)), d=3)


@pytest.mark.parametrize("key", ["length", "time", "mass"])
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_scale_must_be_positive(key, value):
    with pytest.raises(msgspec.ValidationError, match=key):
        msgspec.convert({key: value}, Scale)
