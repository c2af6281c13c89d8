"""The laws for bounded actuation: their equations at random states, written out in numpy.

The gradient of the oracle is a difference quotient of Eqs. (7) and (8) of xue2024 as printed.
"""

import numpy as np
import pytest

import controllers.bounded_formation as formation_law
import controllers.bounded_leader as leader_law
import controllers.bounded_leader_varying as varying_law
from controllers.bounded_formation import BoundedFormationParams, bounded_formation
from controllers.bounded_leader import BoundedLeaderParams, bounded_leader
from controllers.bounded_leader_varying import BoundedLeaderVaryingParams, bounded_leader_varying
from controllers.graph import FormationParams
from controllers.proxy import ProxyParams
from testbed.core.law import Body, Discs, Goal, Neighbours, World

NAMES = ("a", "b", "c", "e")
DELTA, SAFE, EPS = 50.0, 10.0, 1.0
P, Q, RHO, LIMIT, MASS = 0.04, 1e4, 0.1, 0.45, 1.3
PAIRS = {"a-b": 40.0, "b-c": 30.0, "a-c": 80.0, "a-e": 25.0, "b-e": 35.0, "c-e": 45.0}
LED = PAIRS | {"c-leader": 40.0, "a-leader": 35.0}
PROXY = ProxyParams(spring=RHO, limit=LIMIT, weight=P, height=Q, mass=MASS)


def shape(distances):
    return FormationParams(
        range=DELTA, safe=SAFE, far_margin=EPS, near_margin=EPS, distances=distances
    )


def wanted(i, j):
    names = [*NAMES, "leader"]
    return LED.get(f"{names[i]}-{names[j]}") or LED[f"{names[j]}-{names[i]}"]


def psi(x, d):
    near, far = SAFE + EPS, DELTA - EPS
    if x <= d:
        return (x - d) ** 2 * (far - x) / ((x - near) + (d - near) ** 2 * (far - x) / Q)
    return (x - near) * (x - d) ** 2 / ((far - x) + (x - near) * (far - d) ** 2 / Q)


def grad(here, there, d):
    h = 1e-5
    steps = h * np.eye(len(here))
    return np.array(
        [
            (psi(np.linalg.norm(here + e - there), d) - psi(np.linalg.norm(here - e - there), d))
            / (2.0 * h)
            for e in steps
        ]
    )


def sat(x):
    return np.clip(x, -LIMIT, LIMIT)


class Scene:
    """One satellite among three, at a random moment; the others told `late` seconds ago."""

    def __init__(self, seed, d, leader):
        rng = np.random.default_rng(seed)
        self.d, self.t, self.late = d, 7.0, 0.3
        self.me = int(rng.integers(4))
        self.proxy = rng.uniform(-13.0, 13.0, (5, d)) + 26.0 * np.eye(5, d)
        self.speed = rng.normal(0.0, 0.1, (5, d))
        self.p = self.proxy + rng.normal(0.0, 4.0, (5, d))
        self.v = self.speed + rng.normal(0.0, 0.05, (5, d))
        self.p[4], self.v[4] = self.proxy[4], self.speed[4]
        self.edge = rng.integers(0, 2, 5).astype(float)
        self.edge[self.me] = 0.0
        if not leader or self.me not in (0, 2):
            self.edge[4] = 0.0
        self.mass, self.disturbance = 10.0, rng.normal(0.0, 1e-3, d)
        self.accel = rng.normal(0.0, 1e-3, d)
        for j in range(5):  # the oracle knows the inside of the potential only
            gap = np.linalg.norm(self.proxy[self.me] - self.proxy[j])
            if not SAFE + EPS < gap < DELTA - EPS:
                self.edge[j] = 0.0

    def state(self):
        return np.concatenate((self.proxy[self.me], self.speed[self.me], self.edge))

    def sight(self):
        others = np.array([j for j in (2, 0, 3, 1) if j != self.me])  # in no order
        told = np.hstack((self.proxy - self.late * self.speed, self.speed))[others]
        at = np.full(3, self.t - self.late)
        neighbours = Neighbours(self.p[others], self.v[others], np.full(3, SAFE), others, told, at)
        still = np.zeros(self.d)
        own = Body(
            self.p[self.me], self.v[self.me], self.mass, self.disturbance, still, 1e9, self.me
        )
        obstacles = Discs(np.zeros((0, self.d)), np.zeros((0, self.d)), np.zeros(0))
        return own, neighbours, World(Goal(self.p[4], self.v[4], self.accel, still), obstacles)

    def edges(self):
        return [j for j in range(5) if self.edge[j] == 1.0]

    def potential_force(self):
        me = self.proxy[self.me]
        return -P * sum(
            (grad(me, self.proxy[j], wanted(self.me, j)) for j in self.edges()), np.zeros(self.d)
        )

    def stretch(self):
        return self.p[self.me] - self.proxy[self.me]

    def weight(self):
        return self.mass * self.disturbance


def check(law, scene, force, proxy_force):
    found, change = law.rate(scene.state(), *scene.sight(), scene.t)
    assert found == pytest.approx(force, rel=1e-9)
    assert (change[: scene.d] == scene.speed[scene.me]).all()
    assert MASS * change[scene.d : 2 * scene.d] == pytest.approx(proxy_force, rel=1e-5, abs=1e-8)
    assert (change[2 * scene.d :] == 0.0).all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(20))
def test_bounded_formation_is_9_and_14(seed, d):
    scene = Scene(seed, d, leader=False)
    law = bounded_formation(BoundedFormationParams(shape(PAIRS), PROXY, beta=0.1), NAMES, d)
    spring = sat(RHO * scene.stretch())
    check(
        law,
        scene,
        -spring - scene.weight(),
        spring + scene.potential_force() - 0.1 * scene.speed[scene.me],
    )


@pytest.mark.parametrize("feed_forward", [False, True])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(20))
def test_bounded_leader_is_4_5_and_14(seed, d, feed_forward):
    scene = Scene(seed, d, leader=True)
    params = BoundedLeaderParams(shape(LED), PROXY, 0.05, 2.0, feed_forward=feed_forward)
    law = bounded_leader(params, NAMES, d)
    speed, own_v = scene.speed[scene.me], scene.v[scene.me]
    u = -0.05 * sum((speed - scene.speed[j] for j in scene.edges()), np.zeros(d))
    s = own_v - scene.v[4]
    ahead = scene.accel if feed_forward else np.zeros(d)
    check(
        law,
        scene,
        -sat(RHO * scene.stretch() + 2.0 * scene.edge[4] * s) - scene.weight() + scene.mass * ahead,
        sat(RHO * scene.stretch()) + scene.potential_force() + u + MASS * ahead,
    )


@pytest.mark.parametrize("layer", [0.0, 0.1])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(20))
def test_bounded_leader_varying_is_25_to_28(seed, d, layer):
    scene = Scene(seed, d, leader=True)
    params = BoundedLeaderVaryingParams(shape(LED), PROXY, 0.1, 0.3, layer=layer)
    law = bounded_leader_varying(params, NAMES, d)

    def sgn(x):
        return np.clip(x / layer, -1.0, 1.0) if layer else np.sign(x)

    me, edges = scene.me, scene.edges()
    u_hat = -0.1 * sum((sgn(scene.speed[me] - scene.speed[j]) for j in edges), np.zeros(d))
    u = -0.3 * sum((sgn(scene.v[me] - scene.v[j]) for j in edges), np.zeros(d))
    spring = sat(RHO * scene.stretch())
    check(law, scene, -spring - scene.weight() + u, spring + scene.potential_force() + u_hat)


# What they share

LAWS = [
    (formation_law, bounded_formation(BoundedFormationParams(shape(PAIRS), PROXY, 0.1), NAMES, 3)),
    (leader_law, bounded_leader(BoundedLeaderParams(shape(LED), PROXY, 0.05, 0.1), NAMES, 3)),
    (
        varying_law,
        bounded_leader_varying(BoundedLeaderVaryingParams(shape(LED), PROXY, 0.1, 0.3), NAMES, 3),
    ),
]


@pytest.mark.parametrize(("module", "law"), LAWS)
def test_tells_its_proxy(module, law):
    scene = Scene(1, 3, leader=False)
    said = module.broadcast(law.gains, scene.state(), *scene.sight(), scene.t)
    assert (said == scene.state()[:6]).all()
    assert law.message_size == 6


@pytest.mark.parametrize(("module", "law"), LAWS)
def test_edges_jump_and_nothing_else_does(module, law):
    scene = Scene(1, 3, leader=False)
    me, before = scene.me, scene.state()
    after = module.jump(law.gains, before, *scene.sight(), scene.t)
    assert (after[:6] == before[:6]).all()
    for j in range(4):
        gap = np.linalg.norm(scene.p[me] - scene.p[j])
        kept = gap < DELTA and before[6 + j] == 1.0
        assert after[6 + j] == float(j != me and (gap < DELTA - EPS or kept))


@pytest.mark.parametrize(("module", "law"), LAWS)
def test_a_stranger_is_no_neighbour(module, law):
    scene = Scene(1, 3, leader=False)
    own, neighbours, world = scene.sight()
    no_neighbours = neighbours._replace(p=own.p[None], v=own.v[None], radius=np.ones(1))
    no_neighbours = no_neighbours._replace(
        vehicle_index=np.array([-1]), message=np.ones((1, 6)), message_t=np.zeros(1)
    )
    none = Neighbours(*(column[:0] for column in no_neighbours))
    for f in (law.rate, lambda *a: (module.jump(law.gains, *a),)):
        found, expected = (f(scene.state(), own, n, world, 7.0) for n in (no_neighbours, none))
        assert all((a == b).all() for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize(("module", "law"), LAWS)
def test_starts_with_its_proxy_at_rest_where_it_is(module, law):
    own, neighbours, world = Scene(1, 2, leader=False).sight()
    start = law.initial(own, neighbours, world)
    assert (start[:2] == own.p).all()
    assert (start[2:4] == 0.0).all()
    assert (start[4:] == law.gains.coupling.formation.first[own.vehicle_index]).all()


@pytest.mark.parametrize(("module", "law"), LAWS)
def test_who_does_not_hear_the_leader_does_not_read_the_goal(module, law):
    scene = Scene(3, 2, leader=False)
    own, neighbours, world = scene.sight()
    far = World(world.goal._replace(p=world.goal.p + 1e3, v=world.goal.v + 9.0), world.obstacles)
    for one, other in zip(
        law.rate(scene.state(), own, neighbours, world, 7.0),
        law.rate(scene.state(), own, neighbours, far, 7.0),
        strict=True,
    ):
        assert (one == other).all()


def test_a_force_that_is_too_large_keeps_its_direction():
    scene = Scene(4, 2, leader=False)
    own, neighbours, world = scene.sight()
    law = LAWS[0][1]
    full, _ = law.rate(scene.state(), own, neighbours, world, 7.0)
    cut, _ = law.rate(scene.state(), own._replace(max_force=0.01), neighbours, world, 7.0)
    assert np.linalg.norm(cut) == pytest.approx(0.01)
    assert cut / 0.01 == pytest.approx(full / np.linalg.norm(full))


def test_proxies_are_repelled_by_an_obstacle_inside_its_band_only():
    params = ProxyParams(spring=12.0, limit=0.8, weight=0.3, height=0.2, obstacle_band=0.45)
    two = FormationParams(
        range=2.0, safe=0.5, far_margin=0.2, near_margin=0.2, distances={"a-b": 1.5}
    )
    law = bounded_formation(BoundedFormationParams(two, params, 1.0), ("a", "b"), 2)
    still, no_neighbours = np.zeros(2), Neighbours(
        np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0, int), np.zeros((0, 4)),
        np.zeros(0),
    )  # fmt: skip
    own = Body(still, still, 15.0, still, still, 1.0, 0)
    state = law.initial(own, None, None)
    for x, pushed in ((0.94, True), (0.96, False)):
        rock = Discs(np.array([[x, 0.0]]), np.zeros((1, 2)), np.array([0.5]))
        world = World(Goal(still, still, still, still), rock)
        _, change = law.rate(state, own, no_neighbours, world, 0.0)
        assert (change[2] < 0.0) == pushed
        assert change[3] == 0.0


def test_a_band_that_is_too_thin_is_refused():
    thin = ProxyParams(spring=1.0, limit=1.0, weight=1.0, height=1.0, obstacle_band=1.0)
    with pytest.raises(ValueError, match="obstacle_band: expected 0 or more than near_margin"):
        bounded_formation(BoundedFormationParams(shape(PAIRS), thin, 1.0), NAMES, 2)
