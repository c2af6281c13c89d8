"""Compiled flights against the same flights in plain Python, and against the laws themselves."""

import numpy as np
import pytest

import controllers.bounded_leader as leader_law
import controllers.connectivity_dynamic as dynamic_law
from controllers.bifurcating import BifurcatingParams, Phase, bifurcating
from controllers.graph import FormationParams
from controllers.proxy import ProxyParams
from sim_twin.orbit.clohessy_wiltshire import drift_all
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.relative import chief_on, drift, field, frame_at
from testbed.core.law import Body, Discs, Goal, Neighbours, World
from testbed.reproduction.kernel.cluster import cluster, cluster_control, in_metres
from testbed.reproduction.kernel.fleet import Wave, drifts, fly, goal_at, wave_at, wave_integral
from testbed.reproduction.scene import Leader, Obstacles, OrbitParams, WaveParams, place

ORBIT = OrbitParams(6971.0, 0.01, 30.0, 50.0, 30.0, 20.0)
SWING = WaveParams((0.0, 0.0, 0.05), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), 0.06)
NAMES = ["1", "2", "3"]
START = np.array([[-20.0, 0.0, 0.0], [0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
SHAPE = FormationParams(
    range=50.0,
    safe=10.0,
    distances={"1-2": 40.0, "2-3": 40.0, "1-3": 80.0, "3-leader": 40.0},
)


def test_a_wave_and_its_integral():
    wave = Wave(np.array([1.0]), np.array([2.0]), np.array([-3.0]), 0.7)
    t = np.linspace(0.0, 9.0, 20_001)
    values = np.array([wave_at(wave, s)[0] for s in t])
    assert wave_integral(wave, 9.0)[0] == pytest.approx(np.trapezoid(values, t), abs=1e-6)


@pytest.mark.parametrize("law_knows_push", [False, True])
def test_laws_are_told_the_push_only_if_the_place_says_so(law_knows_push):
    where = place(ORBIT, push=SWING, law_knows_push=law_knows_push)
    true, told = np.empty((3, 3)), np.empty((3, 3))
    drifts(where, 5.0, START, 0.0 * START, true, told)
    push = wave_at(SWING.wave(), 5.0)
    untold = np.zeros(3) if law_knows_push else push
    assert true - told == pytest.approx(np.tile(untold, (3, 1)), abs=1e-15)
    assert np.abs(push).min() > 0.0


def test_the_leader_moves_as_its_velocity_says():
    where, h = place(ORBIT, (40.0, 30.0, 0.0), SWING), 1e-3
    before, now, after = (goal_at(where, s) for s in (5.0 - h, 5.0, 5.0 + h))
    assert (after.p - before.p) / (2 * h) == pytest.approx(now.v, abs=1e-8)
    assert (after.v - before.v) / (2 * h) == pytest.approx(now.a, abs=1e-8)
    assert (after.a - before.a) / (2 * h) == pytest.approx(now.jerk, abs=1e-8)
    assert Leader((0.0, 0.0, 0.0), SWING).top_accel == pytest.approx(0.1 * 0.06, rel=1e-5)


class Plain:
    """RK4 once more, with the law's verbs called from Python: the oracle of the compiled one."""

    def __init__(self, module, law, where, mass, coriolis):
        self.module, self.law, self.where = module, law, where
        self.mass, self.coriolis = mass, coriolis

    def sight(self, t, p, v, z):
        frame, still = frame_at(self.where.chief, t), np.zeros(3)
        way, speed = wave_integral(self.where.obstacles_v, t), wave_at(self.where.obstacles_v, t)
        obstacles = Discs(
            self.where.obstacles + way,
            np.tile(speed, (len(self.where.obstacles), 1)),
            self.where.radius,
        )
        world, n = World(goal_at(self.where, t), obstacles), len(p)
        told = [field(frame, p[i]) for i in range(n)]
        if self.coriolis:
            told = [drift(frame, p[i], v[i]) for i in range(n)]
        bodies = [Body(p[i], v[i], self.mass[i], told[i], still, np.inf, i) for i in range(n)]

        def others(i, said):
            who = np.array([j for j in range(n) if j != i])
            return Neighbours(p[who], v[who], np.ones(n - 1), who, said[who], np.full(n - 1, t))

        silent = np.zeros((n, 0))
        said = np.array(
            [self.module.broadcast(self.law.gains, z[i], bodies[i], others(i, silent), world, t)
             for i in range(n)]
        )  # fmt: skip
        return [(bodies[i], others(i, said), world) for i in range(n)]

    def flow(self, t, p, v, z):
        frame = frame_at(self.where.chief, t)
        a, dz = np.empty_like(v), np.empty_like(z)
        for i, (own, neighbours, world) in enumerate(self.sight(t, p, v, z)):
            force, dz[i] = self.law.rate(z[i], own, neighbours, world, t)
            limit = self.where.max_axis
            a[i] = np.clip(force, -limit, limit) / self.mass[i] + drift(frame, p[i], v[i])
        return v, a, dz

    def fly(self, p, v, h, steps):
        z = np.array([self.law.initial(Body(q, q, 10.0, q, q, 1.0, i), None, None)
                      for i, q in enumerate(p)])  # fmt: skip
        for k in range(steps):
            t = k * h
            z = np.array(
                [self.module.jump(self.law.gains, z[i], *sight, t)
                 for i, sight in enumerate(self.sight(t, p, v, z))]
            )  # fmt: skip
            k1 = self.flow(t, p, v, z)
            k2 = self.flow(t + h / 2, *(x + h / 2 * d for x, d in zip((p, v, z), k1, strict=True)))
            k3 = self.flow(t + h / 2, *(x + h / 2 * d for x, d in zip((p, v, z), k2, strict=True)))
            k4 = self.flow(t + h, *(x + h * d for x, d in zip((p, v, z), k3, strict=True)))
            p, v, z = (
                x + h / 6 * (a + 2 * b + 2 * c + d)
                for x, a, b, c, d in zip((p, v, z), k1, k2, k3, k4, strict=True)
            )
        return p, v, z


def test_a_fleet_behind_a_leader_flies_as_in_plain_python():
    params = leader_law.BoundedLeaderParams(
        SHAPE, ProxyParams(spring=0.1, limit=0.45, weight=0.04, height=1e4), alpha=0.05, beta=0.1
    )
    law, mass = leader_law.bounded_leader(params, NAMES, 3), np.array([8.0, 9.0, 10.0])
    where = place(ORBIT, (40.0, 30.0, 0.0), SWING, max_axis=0.3)
    flight = fly(law, where, mass, START, 0.0 * START, step=0.1, steps=200, every=100)
    p, v, z = Plain(leader_law, law, where, mass, coriolis=True).fly(START, 0.0 * START, 0.1, 200)
    assert flight.t.tolist() == pytest.approx([0.0, 10.0, 20.0])
    assert flight.p[-1] == pytest.approx(p, abs=1e-9)
    assert flight.v[-1] == pytest.approx(v, abs=1e-10)
    assert flight.z[-1] == pytest.approx(z, abs=1e-9)
    assert flight.peak.max() >= np.abs(flight.wanted).max()


@pytest.mark.slow
def test_a_fleet_that_talks_and_avoids_flies_as_in_plain_python():
    shape = FormationParams(
        range=120.0, safe=10.0, far_margin=0.1, near_margin=0.1, edges=("1-2", "2-3"),
        distances={"1-2": 60.0, "2-3": 80.0, "1-3": 100.0},
    )  # fmt: skip
    params = dynamic_law.ConnectivityDynamicParams(shape, 0.1, layer=0.005, mass=10.5)
    law, mass = dynamic_law.connectivity_dynamic(params, NAMES, 3), np.array([10.0, 11.0, 11.5])
    start = np.array([[50.0, 70.0, 0.0], [0.0, 0.0, 0.0], [50.0, -70.0, 0.0]])
    v0 = np.tile([2.0, 0.0, 0.0], (3, 1))
    obstacles = Obstacles(
        ((60.0, 0.0, 0.0),), 10.0, WaveParams(cosine=(2.0, 0, 0), sine=(0, 2.0, 0))
    )
    where = place(ORBIT, obstacles=obstacles, max_axis=1.0)
    flight = fly(law, where, mass, start, v0, step=0.05, steps=100, every=100)
    p, v, z = Plain(dynamic_law, law, where, mass, coriolis=True).fly(start, v0, 0.05, 100)
    assert flight.p[-1] == pytest.approx(p, abs=1e-9)
    assert flight.v[-1] == pytest.approx(v, abs=1e-9)
    assert flight.z[-1] == pytest.approx(z, abs=1e-9)


CIRCLE = Phase(a=1.0, b=1.0, r=0.5, mu=-5.0, k_f=3.0, k_v=2000.0, k_c=0.25, s=0.5, sigma=5.0)


@pytest.mark.parametrize("newtons", [1.0, 1000.0])
def test_a_cluster_feels_what_the_law_of_each_of_them_says(newtons):
    rng = np.random.default_rng(3)
    p, v = 200.0 * rng.normal(size=(12, 3)), rng.normal(size=(12, 3))
    phase = in_metres(CIRCLE, newtons)
    law = bifurcating(BifurcatingParams(phases=(phase,), centre=(0.0, 0.0, 0.0)), 3)
    w, still, u, cw = 1.1e-3, np.zeros(3), np.empty((12, 3)), np.empty((12, 3))
    cluster_control(cluster((phase,), 100.0, w), 0.0, p, v, u)
    drift_all(w, p, v, cw)
    world = World(Goal(still, still, still, still), Discs(p[:0], p[:0], np.zeros(0)))
    for i in range(12):
        who = np.array([j for j in range(12) if j != i])
        others = Neighbours(p[who], v[who], np.ones(11), who, np.zeros((11, 0)), np.zeros(11))
        own = Body(p[i], v[i], 100.0, cw[i], still, np.inf, i)
        force, _ = law.rate(np.zeros(0), own, others, world, 0.0)
        assert u[i] == pytest.approx(force / 100.0, rel=1e-9)


def test_units_of_the_paper():
    # 0.2 km outside the circle: 3 (0.04 + 1) = 3.12, kN or N
    for newtons in (1.0, 1000.0):
        control = cluster((in_metres(CIRCLE, newtons),), 100.0, 1e-9)
        u = np.empty((1, 3))
        cluster_control(control, 0.0, np.array([[700.0, 0.0, 0.0]]), np.zeros((1, 3)), u)
        assert u[0] == pytest.approx([-3.12e-2 * newtons, 0.0, 0.0], rel=1e-9)


def test_orbits_of_the_papers_are_in_degrees_and_kilometres():
    assert ORBIT.orbit() == Orbit(
        6971e3, 0.01, *np.radians([30.0, 50.0, 30.0, 20.0]).tolist(), mu=3.986e14
    )
    assert ORBIT.chief() == chief_on(ORBIT.orbit())
