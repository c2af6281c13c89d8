import math

import mpmath as mp
import numpy as np
import pytest

from sim_twin.orbit import smooth
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.relative import (
    chief_on,
    coriolis,
    drift,
    drift_all,
    drift_rate,
    field,
    frame_at,
    frame_of_anomaly,
)

MU = 3.986004418e14
ECCENTRIC = Orbit(a=7000e3, e=0.3)


def pushing(t):
    """A thrust in the chief's frame [m/s^2]."""
    return 2e-3 * np.array([math.sin(0.004 * t), math.cos(0.003 * t), math.sin(0.002 * t + 1.0)])


def fly(orbit, p, v, times, thrust=pushing):
    chief = chief_on(orbit)

    def rate(t, y):
        return np.concatenate([y[3:], drift(frame_at(chief, t), y[:3], y[3:]) + thrust(t)])

    y = smooth.solve(rate, np.concatenate([p, v]), times, rtol=1e-12, atol=1e-10)
    return y[:, :3], y[:, 3:]


@pytest.mark.parametrize(
    ("a", "e", "theta", "p", "v"),
    [
        (7000e3, 0.02, 0.0, (50.0, -80.0, 30.0), (0.1, -0.05, 0.08)),
        (7000e3, 0.3, 0.0, (30.0, 40.0, 25.0), (0.0, 0.0, 0.0)),  # zhang2023's orbit
        (6978e3, 0.0002, 2.0, (500.0, 0.0, -200.0), (0.0, -1.0, 0.3)),  # gao2022's
        (42164e3, 0.0, 1.0, (0.0, 100.0, 0.0), (0.0, 0.0, 0.0)),
    ],
)
def test_motion_agrees_with_two_bodies_in_eci(a, e, theta, p, v, fly_inertially):
    p, v, times = np.array(p), np.array(v), np.linspace(0.0, 6000.0, 7)
    wanted_p, wanted_v = fly_inertially(a, e, theta, p, v, pushing, times)
    found_p, found_v = fly(Orbit(a=a, e=e, theta=theta), p, v, times)
    assert np.linalg.norm(wanted_p[-1]) > 1e3  # the thrust has taken it somewhere
    assert np.linalg.norm(found_p - wanted_p, axis=1).max() <= 1e-6
    assert np.linalg.norm(found_v - wanted_v, axis=1).max() <= 1e-9


def test_the_papers_sign_of_g_is_wrong(fly_inertially):
    p, v, times = np.array([50.0, -80.0, 30.0]), np.array([0.1, -0.05, 0.08]), [0.0, 600.0]
    wanted, _ = fly_inertially(7000e3, 0.02, 0.0, p, v, pushing, times)
    chief = chief_on(Orbit(a=7000e3, e=0.02))

    def rate(t, y):
        frame = frame_at(chief, t)
        return np.concatenate([y[3:], coriolis(frame, y[3:]) - field(frame, y[:3]) + pushing(t)])

    printed = smooth.solve(rate, np.concatenate([p, v]), times)[-1, :3]
    assert np.linalg.norm(printed - wanted[-1]) > 10.0


def exact_drift(orbit, t, p, v):
    """The drift by inertial kinematics with 60 digits: a for which the deputy falls freely."""
    a, e, mu = mp.mpf(orbit.a), mp.mpf(orbit.e), mp.mpf(orbit.mu)
    n = mp.sqrt(mu / a**3)
    half = mp.sqrt((1 - e) / (1 + e)) * mp.tan(mp.mpf(orbit.theta) / 2)
    e0 = 2 * mp.atan(half)
    m0 = e0 - e * mp.sin(e0)

    def anomaly(s):
        m = m0 + n * s
        x = mp.findroot(lambda x: x - e * mp.sin(x) - m, m)
        return x, 2 * mp.atan2(mp.sqrt(1 + e) * mp.sin(x / 2), mp.sqrt(1 - e) * mp.cos(x / 2))

    def inertial(s, k):
        """Component k of the deputy's place if it moved on at `v` in the turning frame."""
        x, theta = anomaly(s)
        radius = a * (1 - e * mp.cos(x))
        ahead = s - t
        out, along = radius + p[0] + v[0] * ahead, p[1] + v[1] * ahead
        if k == 2:
            return p[2] + v[2] * ahead
        turned = (mp.cos(theta), -mp.sin(theta)) if k == 0 else (mp.sin(theta), mp.cos(theta))
        return turned[0] * out + turned[1] * along

    place = [inertial(t, k) for k in range(3)]
    size = mp.sqrt(sum(x * x for x in place))
    lacking = [-mu * place[k] / size**3 - mp.diff(lambda s, k=k: inertial(s, k), t, 2)
               for k in range(3)]  # fmt: skip
    _, theta = anomaly(t)
    c, s = mp.cos(theta), mp.sin(theta)
    return [c * lacking[0] + s * lacking[1], c * lacking[1] - s * lacking[0], lacking[2]]


SCENES = [
    (Orbit(a=7000e3, e=0.02, theta=0.4), 321.0, (100.0, -200.0, 50.0), (0.3, 0.2, -0.1)),
    (Orbit(a=7000e3, e=0.3, theta=1.0), 1500.0, (1000.0, 2000.0, -700.0), (3.0, -2.0, 1.0)),
    (Orbit(a=6978e3, e=0.0002, theta=-2.0), 77.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    (Orbit(a=7000e3, e=0.1, theta=3.0), 900.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
]


@pytest.mark.parametrize(("orbit", "t", "p", "v"), SCENES)
def test_drift_agrees_with_inertial_kinematics_in_60_digits(orbit, t, p, v):
    found = drift(frame_at(chief_on(orbit), t), np.array(p), np.array(v))
    with mp.workdps(60):
        wanted = exact_drift(orbit, mp.mpf(t), [mp.mpf(x) for x in p], [mp.mpf(x) for x in v])
        gap = max(abs(mp.mpf(float(f)) - w) for f, w in zip(found, wanted, strict=True))
    assert gap < 1e-15 * (np.linalg.norm(found) + 1e-3)


@pytest.mark.parametrize(("orbit", "t", "p", "v"), SCENES)
def test_drift_rate_is_the_derivative_along_the_motion(orbit, t, p, v):
    chief, h = chief_on(orbit), 0.25
    p, v = np.array(p), np.array(v)
    a = drift(frame_at(chief, t), p, v) + pushing(t)

    def drift_after(s):
        return drift(frame_at(chief, t + s), p + s * v + 0.5 * s * s * a, v + s * a)

    difference = (
        8.0 * (drift_after(h) - drift_after(-h)) - drift_after(2 * h) + drift_after(-2 * h)
    ) / (12.0 * h)
    found = drift_rate(frame_at(chief, t), p, v, a)
    assert found == pytest.approx(difference, rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("theta", [0.0, 1.0, 3.0, 5.0])
def test_the_frames_rates_are_derivatives_of_each_other(theta):
    chief = chief_on(Orbit(a=7000e3, e=0.3, theta=theta))
    h = 0.5
    now = frame_at(chief, 0.0)
    w = now.spin
    for quantity, rate, scale in [
        ("radius", "climb", now.radius * w),
        ("spin", "spin_rate", w * w),
        ("spin_rate", "spin_jerk", w * w * w),
    ]:
        y = [getattr(frame_at(chief, s * h), quantity) for s in (-2, -1, 1, 2)]
        slope = (y[0] - 8 * y[1] + 8 * y[2] - y[3]) / (12 * h)
        assert getattr(now, rate) == pytest.approx(slope, abs=1e-9 * scale)


def test_chief_and_its_anomaly():
    frame = frame_of_anomaly(chief_on(ECCENTRIC), 0.0)
    assert frame.radius == pytest.approx(4900e3)  # inside the Earth, as zhang2023 has it
    assert frame.climb == 0.0
    assert frame.spin == pytest.approx(math.sqrt(MU * 1.3 / 4900e3**3))
    half_a_turn = math.pi / ECCENTRIC.mean_motion
    assert frame_at(chief_on(ECCENTRIC), half_a_turn).radius == pytest.approx(9100e3)


def test_nothing_drifts_at_the_chief():
    frame = frame_of_anomaly(chief_on(ECCENTRIC), 1.2)
    assert drift(frame, np.zeros(3), np.zeros(3)).tolist() == [0.0, 0.0, 0.0]


def test_near_the_chief_nothing_cancels():
    # a millimetre away the drift is still good to 13 digits: it is linear there
    frame = frame_of_anomaly(chief_on(ECCENTRIC), 1.2)
    p, still = np.array([1.0, -2.0, 0.5]), np.zeros(3)
    tiny = drift(frame, 1e-3 * p, still)
    linear = (drift(frame, 1e-3 * p, still) - drift(frame, -1e-3 * p, still)) / 2.0
    assert tiny == pytest.approx(linear, rel=1e-9)
    w2, point = frame.spin**2, MU / frame.radius**3
    exact = [(w2 + 2 * point) * p[0] + frame.spin_rate * p[1],
             (w2 - point) * p[1] - frame.spin_rate * p[0], -point * p[2]]  # fmt: skip
    assert linear == pytest.approx(1e-3 * np.array(exact), rel=1e-13)


def test_many_at_once_are_the_same_as_one_by_one():
    rng = np.random.default_rng(3)
    p, v = 100.0 * rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    frame, out = frame_of_anomaly(chief_on(ECCENTRIC), 2.0), np.empty((5, 3))
    drift_all(frame, p, v, out)
    for k in range(5):
        assert out[k].tolist() == drift(frame, p[k], v[k]).tolist()
        assert out[k] == pytest.approx(field(frame, p[k]) + coriolis(frame, v[k]))


def test_coriolis_does_no_work():
    rng = np.random.default_rng(4)
    frame = frame_of_anomaly(chief_on(ECCENTRIC), 2.0)
    for v in rng.normal(size=(5, 3)):
        assert v @ coriolis(frame, v) == pytest.approx(0.0, abs=1e-18)
