"""The laws of xue2021: their equations at random states in numpy, and flights on the table."""

import numpy as np
import pytest
from fleet import Fleet, gaps

import controllers.collision_sliding as sliding_law
import controllers.connectivity_dynamic as dynamic_law
import controllers.connectivity_static as static_law
from controllers.formation_potential import FormationPotentialParams
from controllers.graph import FormationParams
from controllers.log_potential import log_potential, repulsion
from testbed.core.law import Body, Discs, Goal, Neighbours, World

NAMES = ("a", "b", "c", "e")
PAIRS = {"a-b": 60.0, "b-c": 80.0, "a-c": 100.0, "a-e": 50.0, "b-e": 70.0, "c-e": 90.0}
HELD = ("a-b", "b-c", "a-e")
SHAPE = FormationParams(
    range=120.0, safe=10.0, far_margin=0.1, near_margin=0.1, distances=PAIRS, edges=HELD
)
K_F, K_O, K_R, K_A, K_D, D_O = 10.0, 7.0, 0.2, 0.05, 0.3, 40.0


def potential(pair_count=2):
    return FormationPotentialParams(K_F, K_O, K_R, K_A, K_D, D_O - 10.0, pair_count)


def look_up(table, i, j):
    return table.get(f"{NAMES[i]}-{NAMES[j]}") or table[f"{NAMES[j]}-{NAMES[i]}"]


class Scene:
    """One satellite among three and two obstacles, at a random moment."""

    def __init__(self, seed, d):
        rng = np.random.default_rng(seed)
        self.d, self.me = d, int(rng.integers(4))
        corners = 45.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])[:, :d]
        self.p = corners + rng.uniform(-15.0, 15.0, (4, d))
        self.v = rng.normal(0.0, 0.5, (4, d))
        self.s = rng.normal(0.0, 0.5, (4, d))  # what the others told
        self.edge = np.append(rng.integers(0, 2, 4), 0).astype(float)
        self.edge[self.me] = 0.0
        self.disturbance, self.mass_hat = rng.normal(0.0, 0.1, d), 10.5
        away = rng.normal(size=(2, d))
        away *= np.array([[25.0], [45.0]]) / np.linalg.norm(away, axis=1, keepdims=True)
        self.obstacles, self.obstacles_v = self.p[self.me] + away, rng.normal(0.0, 2.0, (2, d))

    def sight(self):
        others = np.array([j for j in (2, 0, 3, 1) if j != self.me])
        still, three = np.zeros(self.d), np.full(3, 10.0)
        neighbours = Neighbours(
            self.p[others], self.v[others], three, others, self.s[others], np.zeros(3)
        )
        own = Body(self.p[self.me], self.v[self.me], 9.0, self.disturbance, still, 1e9, self.me)
        obstacles = Discs(self.obstacles, self.obstacles_v, np.full(2, 10.0))
        return own, neighbours, World(Goal(still, still, still, still), obstacles)

    def edges(self):
        return [j for j in range(4) if self.edge[j] == 1.0]

    def pair_slope(self, j, everybody_held=None):
        """Eq. (30)."""
        x, d = np.linalg.norm(self.p[self.me] - self.p[j]), look_up(PAIRS, self.me, j)
        held = {f"{NAMES[a]}-{NAMES[b]}" for a, b in ((self.me, j), (j, self.me))} & set(HELD)
        held = bool(held) if everybody_held is None else everybody_held
        if x <= d:
            return K_R * (x - d) / (x - 10.0)
        if held:
            return K_A * (x - d) / (120.0 - x)
        return K_D * np.pi / (120.0 - d) * np.sin(np.pi * (x - d) / (120.0 - d))

    def unit(self, there):
        return (self.p[self.me] - there) / np.linalg.norm(self.p[self.me] - there)

    def obstacle(self, k):
        """Eq. (5)'s gradient, K_o included."""
        x = np.linalg.norm(self.p[self.me] - self.obstacles[k])
        slope = K_R * (x - D_O) / (x - 10.0) if x < D_O else 0.0
        return K_O * slope * self.unit(self.obstacles[k])

    def psi(self, count, edges, everybody_held=None):
        """Eq. (9)'s gradient."""
        pairs = (self.pair_slope(j, everybody_held) * self.unit(self.p[j]) for j in edges)
        return count * K_F * sum(pairs, np.zeros(self.d)) + self.obstacle(0) + self.obstacle(1)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(15))
def test_static_is_6_to_9(seed, d, count):
    scene = Scene(seed, d)
    params = static_law.ConnectivityStaticParams(SHAPE, potential(count), 0.4, 0.3, 0.2)
    law = static_law.connectivity_static(params, NAMES, d)
    state = np.concatenate(([scene.mass_hat], scene.edge))

    force, change = law.rate(state, *scene.sight(), 0.0)

    v, y = scene.v[scene.me], -scene.disturbance
    drag = 0.4 * sum((scene.v[j] - v for j in scene.edges()), np.zeros(d)) - 0.3 * v
    expected = drag - scene.psi(count, scene.edges()) + scene.mass_hat * y
    assert force == pytest.approx(expected, rel=1e-10)
    assert change[0] == pytest.approx(-0.2 * v @ y, rel=1e-10)
    assert (change[1:] == 0.0).all()


@pytest.mark.parametrize("swerve", ["off", "smooth", "paper"])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(15))
def test_dynamic_is_15_to_22(seed, d, swerve):
    scene = Scene(seed, d)
    params = dynamic_law.ConnectivityDynamicParams(
        SHAPE, 0.7, potential(), k_c=0.4, beta=0.05, kappa=0.6, swerve=swerve, nu=0.2, alpha=0.3
    )
    law = dynamic_law.connectivity_dynamic(params, NAMES, d)
    state = np.concatenate(([scene.mass_hat], scene.edge))

    force, change = law.rate(state, *scene.sight(), 0.0)
    told = dynamic_law.broadcast(law.gains, state, *scene.sight(), 0.0)

    psi, y = scene.psi(2, scene.edges()), -scene.disturbance
    w = np.zeros(d)
    for k in range(2):
        power = scene.obstacle(k) * scene.obstacles_v[k]
        w += {"off": 0.0, "smooth": power * psi / (psi**2 + 0.2**2), "paper": power / psi}[swerve]
    s = scene.v[scene.me] + 0.6 * psi - w
    drag = 0.4 * sum((s - scene.s[j] for j in scene.edges()), np.zeros(d)) + 0.7 * s
    expected = -drag - 0.05 * np.sign(s) - psi + scene.mass_hat * y
    assert force == pytest.approx(expected, rel=1e-9)
    assert change[0] == pytest.approx(-0.3 * s @ y, rel=1e-9)
    assert told == pytest.approx(s, rel=1e-9)
    assert law.message_size == d


@pytest.mark.parametrize("attract", ["log", "cosine"])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(15))
def test_baseline_is_31_and_32(seed, d, attract):
    scene = Scene(seed, d)
    params = sliding_law.CollisionSlidingParams(SHAPE, potential(1), attract)
    law = sliding_law.collision_sliding(params, NAMES, d)

    force, change = law.rate(np.array([scene.mass_hat]), *scene.sight(), 0.0)

    others = [j for j in range(4) if j != scene.me]
    s = scene.v[scene.me] + 0.1 * scene.psi(1, others, everybody_held=attract == "log")
    expected = -0.2 * np.sign(s) - scene.mass_hat * scene.disturbance - 0.1 * s
    assert force == pytest.approx(expected, rel=1e-10)
    assert change == pytest.approx([0.5 * s @ scene.disturbance], rel=1e-10)


@pytest.mark.parametrize("x", [30.0, 59.0, 61.0, 119.0, 121.0, 400.0])
def test_the_continued_well_pulls_at_every_distance(x):
    shape = FormationParams(range=120.0, safe=10.0, distances={"a-b": 60.0})
    weights = FormationPotentialParams(k_f=40.0, k_r=0.2, k_a=0.05, pair_count=1)
    params = sliding_law.CollisionSlidingParams(shape, weights, "continued")
    law, still = sliding_law.collision_sliding(params, ("a", "b"), 2), np.zeros(2)
    own = Body(still, still, 10.0, still, still, 1e9, 0)
    other = Neighbours(
        np.array([[x, 0.0]]), np.zeros((1, 2)), np.ones(1), np.array([1]),
        np.zeros((1, 0)), np.zeros(1),
    )  # fmt: skip
    world = World(
        Goal(still, still, still, still), Discs(np.zeros((0, 2)), np.zeros((0, 2)), still[:0])
    )
    force, _ = law.rate(np.array([10.0]), own, other, world, 0.0)
    pull = 40.0 * (0.2 if x < 60.0 else 0.05) * (x - 60.0) / (x - 10.0)
    s = -0.1 * pull  # tau grad J: towards the other one is +x
    assert force == pytest.approx([-0.2 * np.sign(s) - 0.1 * s, 0.0])


def test_the_paper_swerves_without_a_bound_and_the_smooth_one_does_not():
    # an obstacle and a neighbour push against each other: one component of grad Psi crosses zero
    shape = FormationParams(range=120.0, safe=10.0, distances={"a-b": 60.0})
    still, own_v = np.zeros(2), np.zeros(2)
    largest = {}
    for swerve in ("paper", "smooth"):
        params = dynamic_law.ConnectivityDynamicParams(shape, 0.1, swerve=swerve, nu=0.1)
        law = dynamic_law.connectivity_dynamic(params, ("a", "b"), 2)
        found = []
        for x in np.linspace(20.0, 59.0, 4000):
            own = Body(still, own_v, 10.0, still, still, 1e9, 0)
            other = Neighbours(
                np.array([[x, 0.0]]), np.zeros((1, 2)), np.ones(1), np.array([1]),
                np.zeros((1, 2)), np.zeros(1),
            )  # fmt: skip
            rock = Discs(np.array([[-30.0, 0.0]]), np.array([[2.0, 0.0]]), np.array([10.0]))
            world = World(Goal(still, still, still, still), rock)
            state = law.initial(own, None, None)
            found.append(np.abs(law.rate(state, own, other, world, 0.0)[0]).max())
        largest[swerve] = max(found)
    assert largest["paper"] > 5.0 * largest["smooth"]


def test_a_baseline_that_holds_a_pair_beyond_its_range_is_refused():
    shape = FormationParams(range=90.5, safe=10.0, distances=PAIRS)
    params = sliding_law.CollisionSlidingParams(shape, attract="log")
    with pytest.raises(ValueError, match='found a desired distance of 100 m: choose "cosine"'):
        sliding_law.collision_sliding(params, NAMES, 2)


def test_a_band_thinner_than_the_margin_is_refused():
    thin = FormationPotentialParams(obstacle_band=0.05)
    with pytest.raises(ValueError, match="obstacle_band: expected 0 or more"):
        static_law.connectivity_static(static_law.ConnectivityStaticParams(SHAPE, thin), NAMES, 2)


# Flights at table scale, 1/48 of the paper's

THREE = ("a", "b", "c")
TABLE = FormationParams(
    range=2.5,
    safe=0.45,
    far_margin=0.02,
    near_margin=0.02,
    distances={"a-b": 1.25, "b-c": 1.67, "a-c": 2.08},
    edges=("a-b", "b-c"),
)
GENTLE = FormationPotentialParams(
    k_f=0.2, k_o=0.3, k_r=1.0, k_a=1.0, k_d=1.0, obstacle_band=0.45, pair_count=1
)
START = np.array([[50.0, 70.0], [0.0, 0.0], [50.0, -70.0]]) / 48.0
PUSH = np.tile([0.1, 0.0], (3, 1))


def rock(velocity):
    def at(t):
        centre = np.array([[60.0 / 48.0, 0.0]]) + t * np.array([velocity])
        return Discs(centre, np.array([velocity]), np.array([0.45]))

    return at


def static(k_c=2.5, k_v=1.5, **changes):
    params = static_law.ConnectivityStaticParams(TABLE, GENTLE, k_c, k_v, **changes)
    return static_law.connectivity_static(params, THREE, 2)


def v_1(fleet, state):
    """Eq. (10); a pair out of range counts as the level of psi^d there."""
    t, p, v, z = state
    u = fleet.law.gains.potential
    total = 0.5 * float(fleet.mass @ (v**2).sum(axis=1))
    total += 0.5 / fleet.law.gains.alpha * float(((fleet.mass - z[:, 0]) ** 2).sum())
    for i in range(3):
        for j in range(i):
            x = np.linalg.norm(p[i] - p[j]) if z[i, 1 + j] else u.single.range
            d, held = u.formation.desired[i, j], u.formation.first[i, j] > 0.5
            total += u.pairs * log_potential(u.single, x, d, held)[0]
        for centre in fleet.obstacles(t).p:
            x = np.linalg.norm(p[i] - centre)
            total += u.obstacles * repulsion(u.single, x, 0.9, 0.45)[0]
    return total


def test_v1_of_the_static_law_falls_whatever_the_mass_and_the_drift():
    turn = np.array([[0.0, 0.05], [-0.05, 0.0]])
    fleet = Fleet(
        static_law,
        static(alpha=20.0, mass=12.0),
        [15.0, 14.0, 16.0],
        disturbance=lambda p, v: turn @ v + 0.01 * p,
        obstacles=rock([0.0, 0.0]),
    )
    *flight, _ = fleet.fly(START, PUSH, 60.0, 0.02, every=5)
    energy = np.array([v_1(fleet, state) for state in zip(*flight, strict=True)])
    assert (np.diff(energy) < 1e-9).all()
    assert energy[-1] < 0.7 * energy[0]
    assert np.ptp(flight[3][:, :, 0], axis=0).min() > 0.01  # the mass did adapt


def inside(p, centres):
    """Held edges inside the range, pairs and obstacle not touched."""
    pairs = np.array([gaps(p, 0, 1), gaps(p, 1, 2), gaps(p, 0, 2)])
    obstacles = np.linalg.norm(p - centres[:, None], axis=2)
    return pairs[:2].max() < 2.5 and pairs.min() > 0.45 and obstacles.min() > 0.45


def test_static_formation_is_reached_around_the_obstacle():
    fleet = Fleet(static_law, static(), [15.0] * 3, obstacles=rock([0.0, 0.0]))
    _, p, v, _, force = fleet.fly(START, PUSH, 120.0, 0.05)
    assert inside(p, np.tile([60.0 / 48.0, 0.0], (len(p), 1)))
    assert gaps(p, 0, 1)[-1] == pytest.approx(1.25, abs=0.05)
    assert gaps(p, 1, 2)[-1] == pytest.approx(1.67, abs=0.05)
    assert gaps(p, 0, 2)[-1] == pytest.approx(2.08, abs=0.05)
    assert np.abs(v[-1]).max() < 0.01
    assert np.linalg.norm(force, axis=2).max() <= 1.0  # never cut, so Theorem 1 holds


@pytest.mark.parametrize("swerve", ["off", "smooth"])
def test_dynamic_formation_is_reached_behind_a_crossing_obstacle(swerve):
    params = dynamic_law.ConnectivityDynamicParams(
        TABLE, 1.5, GENTLE, k_c=2.5, beta=0.02, layer=0.01, kappa=0.1, swerve=swerve
    )
    law = dynamic_law.connectivity_dynamic(params, THREE, 2)
    velocity = [0.0, 0.063]
    fleet = Fleet(dynamic_law, law, [15.0] * 3, obstacles=rock(velocity), max_force=1.4)
    t, p, v, _, _ = fleet.fly(START, PUSH, 150.0, 0.05)
    assert inside(p, np.array([rock(velocity)(s).p[0] for s in t]))
    assert gaps(p, 0, 1)[-1] == pytest.approx(1.25, abs=0.05)
    assert gaps(p, 1, 2)[-1] == pytest.approx(1.67, abs=0.05)
    assert np.abs(v[-1]).max() < 0.01


def test_the_baseline_can_lose_an_edge_where_the_static_law_does_not():
    # gains picked so that it does: not every choice of them disconnects
    weak = FormationPotentialParams(
        k_f=0.6, k_o=0.9, k_r=1.0, k_a=0.05, k_d=0.05, obstacle_band=0.45, pair_count=1
    )
    params = sliding_law.CollisionSlidingParams(
        TABLE, weak, gamma=0.05, k_d=0.3, tau=0.1, layer=0.005
    )
    law = sliding_law.collision_sliding(params, THREE, 2)
    fleet = Fleet(sliding_law, law, [15.0] * 3, obstacles=rock([0.0, 0.0]))
    _, p, _, _, _ = fleet.fly(START, PUSH, 60.0, 0.05)
    assert max(gaps(p, 0, 1).max(), gaps(p, 1, 2).max()) > 2.5
