"""The plant against the equations of motion, written down a second time and left to scipy.

The oracle takes the drawn vehicle's numbers and the times of the opening commands, nothing else of
the plant: its own flow, air and rigid body, and DOP853 from one corner of the flow to the next.
"""

from math import cos, sin
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import DOP853

PERIOD = 100_000  # of the jets [us]
HALF = 5000.0  # of the table, far from all that happens [m]
JETS = 8

SLOW_VALVE = {
    "open_delay_s": 0.006, "close_delay_s": 0.009, "open_ramp_s": 0.004, "close_ramp_s": 0.005,
}  # fmt: skip
TOLERANCE = {
    "thrust": 0.05, "direction_deg": 1.0, "pulse": 0.01, "mass": 0.01, "inertia": 0.05, "com": 0.01,
}  # fmt: skip
AIR = {
    "exhaust_speed": 600.0, "bearing_flow": 5e-5, "droop": 0.02, "tank_position": (-0.05, 0.08),
}  # fmt: skip
# supply pressure falls from the first pulse on, or after some seconds
LAST_GAS = {"air": AIR | {"gas": 0.05, "tank_pressure": 0.5e6}}
GAS_FOR_A_WHILE = {"air": AIR | {"gas": 0.05, "tank_pressure": 0.7e6}}
FREE = {"drag": 0.0, "spin_drag": 0.0}
REAL = {
    "com": (0.01, -0.02), "drag": 0.3, "spin_drag": 0.01,
    "valve": SLOW_VALVE, "tolerance": TOLERANCE, "air": AIR,
}  # fmt: skip
LEVEL = {"uniform": (0.0, 0.0), "map": []}
WARPED = {  # one bilinear patch, so that there is no kink to fly over [m/s^2]
    "uniform": (0.0017, 0.0010),
    "map": [[(-0.30, -0.20), (0.25, -0.35)], [(-0.15, 0.30), (0.30, 0.15)]],
}


class Opening(NamedTuple):
    """One opening of one valve: commanded on [up, down)."""

    jet: int
    up: int  # [us]
    down: int  # [us]
    strength: float


def draw_plan(rng, valve, idle):
    """Offset and on-time of each jet [us] such that the board plays them as they are.

    Args:
        rng: generator.
        valve: of the vehicle.
        idle: how long each jet will have been closed when the plan starts [us].
    """
    min_on, min_off = round(valve.min_on_s * 1e6), round(valve.min_off_s * 1e6)
    offset, on = np.zeros(JETS, dtype=int), np.zeros(JETS, dtype=int)
    for jet, shape in enumerate(rng.choice(5, JETS, p=(0.7, 0.1, 0.1, 0.07, 0.03))):
        if shape == 1:  # centred
            on[jet] = rng.integers(min_on, PERIOD - 2 * min_off)
            offset[jet] = (PERIOD - on[jet]) // 2
        elif shape == 2:  # anywhere
            offset[jet] = rng.integers(min_off, PERIOD - min_on)
            on[jet] = rng.integers(min_on, PERIOD - offset[jet] + 1)
        elif shape == 3:  # to the end of the period, so that the next plan may go on
            offset[jet] = rng.integers(min_off, PERIOD - min_on)
            on[jet] = PERIOD - offset[jet]
        elif shape == 4 and (idle[jet] == 0 or idle[jet] >= min_off):
            on[jet] = PERIOD
    return offset, on


def fly(plant, vehicle, make_plan, periods, rng, times):
    """Fly random plans: states at `times`, shape (n, 6), and the openings."""
    board, delay = plant.boards["0"], round(vehicle.command_delay_s * 1e6)
    openings, idle, seen = [], np.full(JETS, PERIOD), []
    for k in range(periods):
        offset, on = draw_plan(rng, vehicle.valve, idle)
        pulses = {j: (offset[j] * 1e-6, on[j] * 1e-6) for j in np.flatnonzero(on)}
        board.apply(make_plan(k * PERIOD * 1e-6, pulses))
        start = k * PERIOD + delay
        for j in pulses:
            up, down = start + int(offset[j]), start + int(offset[j] + on[j])
            strength = board.pulses.strength[j, -1]
            before = next((o for o in reversed(openings) if o.jet == j), None)
            if before and before.down == up:
                openings[openings.index(before)] = before._replace(down=down)
            else:
                openings.append(Opening(int(j), up, down, float(strength)))
        idle = np.where(on > 0, PERIOD - offset - on, idle + PERIOD)
        begin, end = k * PERIOD * 1e-6, (k + 1) * PERIOD * 1e-6
        seen.append(plant.advance(end, times[(times > begin) & (times <= end)])[:, 0])
    return np.concatenate(seen), openings


def flows(openings, valve, times):
    """How far each jet is open, shape (len(times), jets), and the corners of all of that."""
    level, corners = np.zeros((len(times), JETS)), []
    for jet in range(JETS):
        knots, values = [-1.0], [0.0]
        for o in (o for o in openings if o.jet == jet):
            rise = o.up * 1e-6 + valve.open_delay_s
            fall = o.down * 1e-6 + valve.close_delay_s
            peak = min(1.0, (fall - rise) / valve.open_ramp_s)
            top, end = rise + peak * valve.open_ramp_s, fall + peak * valve.close_ramp_s
            assert rise > knots[-1], "the oracle knows no pulses of one jet that overlap"
            knots += [rise, top, fall, end]
            values += [0.0, peak * o.strength, peak * o.strength, 0.0]
        level[:, jet] = np.interp(times, knots, values)
        corners += knots[1:]
    return level, corners


class Oracle:
    """Rate of change of (x, y, theta, vx, vy, omega, gas used) of one drawn vehicle."""

    def __init__(self, parameters, table):
        self.mass0, self.inertia0 = float(parameters.mass[0]), float(parameters.inertia[0])
        (self.cx0, self.cy0), (self.tx, self.ty) = (
            parameters.com[0].tolist(),
            parameters.tank[0].tolist(),
        )
        self.drag, self.spin_drag = float(parameters.drag[0]), float(parameters.spin_drag[0])
        self.gas, self.exhaust = float(parameters.gas[0]), float(parameters.exhaust_speed[0])
        self.bearing, self.droop = float(parameters.bearing_flow[0]), float(parameters.droop[0])
        self.tank_pressure = float(parameters.tank_pressure[0])
        self.set_pressure, self.dropout = (
            float(parameters.set_pressure[0]),
            float(parameters.dropout[0]),
        )
        self.jets = np.vstack([parameters.effect[0], parameters.thrust[0]])  # (4, jets)
        self.uniform = table.tilt.uniform
        # bilinear a + b x + c y + d x y through the four corners
        nodes = np.array(table.tilt.map or np.zeros((2, 2, 2)))
        (ll, lr), (ul, ur) = nodes
        coefficients = [
            (ll + lr + ul + ur) / 4,
            (lr + ur - ll - ul) / (4 * HALF),
            (ul + ur - ll - lr) / (4 * HALF),
            (ll + ur - lr - ul) / (4 * HALF**2),
        ]
        self.slopes = np.array(coefficients).T.tolist()

    def body(self, used):
        """Mass, centre of mass, inertia about it: the full body less a point mass at the tank."""
        mass = self.mass0 - used
        cx = (self.mass0 * self.cx0 - used * self.tx) / mass
        cy = (self.mass0 * self.cy0 - used * self.ty) / mass
        about_origin = (
            self.inertia0
            + self.mass0 * (self.cx0**2 + self.cy0**2)
            - used * (self.tx**2 + self.ty**2)
        )
        return mass, cx, cy, about_origin - mass * (cx**2 + cy**2)

    def rate(self, t, y, value, slope):
        """With jets (fx, fy, tau, sum of thrusts) = value + t slope at full supply pressure."""
        px, py, theta, vx, vy, omega, used = y.tolist()
        tank = self.tank_pressure * (1.0 - used / self.gas)
        supply = min(1.0, max(0.0, tank - self.dropout) / self.set_pressure)
        fx, fy, tau, thrust = (supply * (a + t * b) for a, b in zip(value, slope, strict=True))
        mass, cx, cy, inertia = self.body(used)
        c, s = cos(theta), sin(theta)
        rx, ry = c * cx - s * cy, s * cx + c * cy
        qx, qy = px + rx, py + ry  # centre of mass
        gx, gy = (
            level + k0 + kx * qx + ky * qy + kxy * qx * qy
            for level, (k0, kx, ky, kxy) in zip(self.uniform, self.slopes, strict=True)
        )
        alpha = (tau - (cx * fy - cy * fx) - self.spin_drag * omega) / inertia
        ax = (c * fx - s * fy - self.drag * (vx - omega * ry)) / mass + gx
        ay = (s * fx + c * fy - self.drag * (vy + omega * rx)) / mass + gy
        return np.array([
            vx, vy, omega,
            ax + alpha * ry + omega**2 * rx,
            ay - alpha * rx + omega**2 * ry,
            alpha,
            thrust / self.exhaust + (self.bearing if used < self.gas else 0.0),
        ])  # fmt: skip

    def fly(self, state, openings, valve, times):
        """States and gas used at `times`, shape (n, 7)."""
        _, corners = flows(openings, valve, np.empty(0))
        knots = np.unique(np.concatenate([[0.0], times, corners]))
        knots = knots[(knots >= 0.0) & (knots <= times[-1])]
        knots = knots[np.diff(knots, prepend=-1.0) > 1e-12]  # what is one instant but for rounding
        span = np.diff(knots)
        early, _ = flows(openings, valve, knots[:-1] + 0.25 * span)
        late, _ = flows(openings, valve, knots[:-1] + 0.75 * span)
        droop = 1.0 + self.droop * np.maximum((early > 0.0).sum(axis=1) - 1, 0)
        early, late = (level @ self.jets.T / droop[:, None] for level in (early, late))
        slope = (late - early) / (0.5 * span[:, None])
        value = early - 0.25 * span[:, None] * slope
        y, track = np.append(state, 0.0), [np.append(state, 0.0)]
        for h, v, s in zip(span.tolist(), value.tolist(), slope.tolist(), strict=True):
            y = integrate(lambda t, y, v=v, s=s: self.rate(t, y, v, s), y, h)
            track.append(y)
        return np.array(track)[np.abs(knots[:, None] - times).argmin(axis=0)]


def integrate(rate, y, h):
    solver = DOP853(rate, 0.0, y, h, rtol=1e-13, atol=1e-16, first_step=h)
    while solver.status == "running":
        solver.step()
    assert solver.status == "finished"
    return solver.y


class Errors(NamedTuple):
    """Largest difference between plant and oracle at any of the sampled times."""

    position: float  # [m]
    heading: float  # [rad]
    velocity: float  # [m/s]
    turn_rate: float  # [rad/s]
    gas: float  # at the end [kg]


@pytest.fixture(scope="module")
def compare(make_vehicle, make_table, make_plant, make_plan):
    def run(seconds, vehicle_changes, tilt, turn_rate=0.1, seed=1):
        vehicle = make_vehicle(**vehicle_changes)
        table = make_table(size=(2 * HALF, 2 * HALF), tilt=tilt)
        start = np.array([1.0, -2.0, 0.3, 0.05, -0.02, turn_rate])
        plant = make_plant([vehicle], [start], table, seed=seed)
        rng = np.random.default_rng(seed)
        times = np.append(np.sort(rng.uniform(0.0, seconds, 30)), seconds)
        seen, openings = fly(plant, vehicle, make_plan, seconds * 10, rng, times)
        wanted = Oracle(plant.parameters, table).fly(start, openings, vehicle.valve, times)
        error = np.abs(seen - wanted[:, :6]).max(axis=0)
        gas = abs(plant.used[0] - wanted[-1, 6])
        assert len(openings) > 5 * seconds
        return Errors(error[:2].max(), error[2], error[3:5].max(), error[5], gas)

    return run


@pytest.mark.parametrize(
    ("seconds", "vehicle", "tilt", "turn_rate"),
    [
        pytest.param(30, {}, LEVEL, 0.1, id="jets alone"),
        pytest.param(30, REAL | {"air": {"droop": 0.02}}, WARPED, 0.1, id="gas without weight"),
        pytest.param(150, REAL, WARPED, 0.1, id="everything"),
        pytest.param(30, REAL, WARPED, -6.0, id="spinning"),
        pytest.param(30, REAL | FREE, LEVEL, 6.0, id="spinning freely"),
        pytest.param(30, REAL | LAST_GAS, WARPED, 0.1, id="regulator out"),
    ],
)
def test_the_plant_agrees_with_the_oracle_to_a_nanometre(
    compare, seconds, vehicle, tilt, turn_rate
):
    error = compare(seconds, vehicle, tilt, turn_rate)
    assert error.position < 1e-9
    assert error.heading < 1e-9
    assert error.velocity < 1e-10
    assert error.turn_rate < 1e-10
    assert error.gas < 1e-12


def test_the_regulator_falls_out_on_the_way(compare):
    # the supply pressure has one kink, and it lies within a step
    error = compare(30, REAL | GAS_FOR_A_WHILE, WARPED)
    assert error.position < 1e-6
    assert error.heading < 1e-6
    assert error.gas < 1e-9
