"""The linear models against the equations of motion; Riccati's cost against sums."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controllers.sampled import cost_to_go, feedback, sampled, weights


def hill(n, d):
    """Right-hand side of Clohessy-Wiltshire, written out."""

    def rate(t, x, a):
        p, v = x[:d], x[d:]
        out = np.zeros(d)
        out[0] = 3.0 * n * n * p[0] + 2.0 * n * v[1] + a[0]
        out[1] = -2.0 * n * v[0] + a[1]
        if d == 3:
            out[2] = -n * n * p[2] + a[2]
        return np.concatenate((v, out))

    return rate


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [0.0, 1.1e-3, 0.05])
def test_a_step_is_exact(n, d):
    rng = np.random.default_rng(1)
    x, a, h = rng.normal(size=2 * d), rng.normal(size=d), 7.0
    model = sampled(n, d, h)
    flown = solve_ivp(hill(n, d), (0.0, h), x, args=(a,), rtol=1e-12, atol=1e-12).y[:, -1]
    assert model.a @ x + model.b @ a == pytest.approx(flown, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("n", "d"), [(0.0, 2), (0.02, 3)])
def test_cost_to_go_is_the_cost_that_is_paid(n, d):
    model, cost = sampled(n, d, 0.5), weights(1.0, 0.3, 0.05, d)
    p, k = cost_to_go(model, cost), feedback(model, cost)
    x = np.random.default_rng(2).normal(size=2 * d)
    expected, paid = x @ p @ x, 0.0
    for _ in range(2000):
        a = -k @ x
        paid += x @ cost.state @ x + a @ cost.accel @ a
        x = model.a @ x + model.b @ a
    assert paid == pytest.approx(expected, rel=1e-9)


def test_no_other_gain_costs_less():
    model, cost = sampled(0.0, 1, 0.5), weights(1.0, 0.3, 0.05, 1)
    best = feedback(model, cost)

    def paid(k):
        x, total = np.array([1.0, -0.2]), 0.0
        for _ in range(1000):
            a = -k @ x
            total += x @ cost.state @ x + a @ cost.accel @ a
            x = model.a @ x + model.b @ a
        return total

    least = paid(best)
    for change in np.random.default_rng(3).normal(size=(20, 1, 2)):
        assert paid(best * (1.0 + 0.02 * change)) > least
