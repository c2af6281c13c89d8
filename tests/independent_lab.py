"""A lab that is not ours: its own plant, valves, cameras and files, to check a calibration against.

Nothing here is taken from the twin. Heading and path are integrals of piecewise smooth functions of
time, because no force depends on place or speed: Simpson's rule on a grid of 0.5 ms gives them to
micrometres. A vehicle pushes off gas, so it gets lighter; its centre of mass is off the origin; the
table slopes; valves open and close late, with ramps; jets share one supply.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 5e-4  # [s] of the integration
PERIOD = 0.1  # [s] of the valve commands


class Thruster(NamedTuple):
    """A nozzle on the vehicle."""

    x: float  # [m] from the origin of the markers
    y: float
    angle: float  # [rad] in which the vehicle is pushed, from its x axis
    force: float  # [N] when open alone


class Robot(NamedTuple):
    """A vehicle with its true numbers."""

    mass: float  # [kg] with a full tank
    inertia: float  # [kg m^2] about the centre of mass
    com: tuple[float, float]  # [m] from the origin of the markers
    jets: list[Thruster]
    opens_s: float  # from the command until the flow rises
    closes_s: float  # from the command until the flow falls
    ramp_s: float
    droop: float  # n open jets have force / (1 + droop (n - 1)) each
    exhaust: float  # [m/s] force over gas per second


class Lab(NamedTuple):
    """What surrounds the vehicle."""

    rate: float  # [Hz] of the cameras
    noise: float  # [m] of a position, white
    noise_rad: float
    slope: tuple[float, float]  # [m/s^2] by which the table accelerates a vehicle
    latency: float = 0.0  # [s] between the exposure of a pose and its row in the log


def ring(count: int, arm: float, side: float, force: float) -> list[Thruster]:
    """Jets in pairs that push along the axes; a ninth one pushes across, through the middle."""
    quarter = np.pi / 2
    jets = []
    for k in range(4):  # faces at 0, 90, 180 and 270 degrees, each pushed inwards
        c, s = np.cos(k * quarter), np.sin(k * quarter)
        for across in (side, -side):
            x, y = c * arm - s * across, s * arm + c * across
            jets.append(Thruster(float(x), float(y), k * quarter + np.pi, force))
    jets.append(Thruster(float(-0.5 * arm), float(-0.4 * arm), 0.7, 0.8 * force))
    return jets[:count]


def true_one(robot: Robot, rng: np.random.Generator, spread: float = 0.08) -> Robot:
    """A vehicle as it was built: near its drawing, but not the same."""
    jets = [
        one._replace(force=one.force * float(1.0 + spread * rng.uniform(-1.7, 1.7)))
        for one in robot.jets
    ]
    late = float(rng.uniform(0.0, 0.03))
    return robot._replace(
        jets=jets,
        inertia=robot.inertia * float(1.0 + 0.1 * rng.uniform(-1.7, 1.7)),
        com=(float(rng.uniform(-6e-3, 6e-3)), float(rng.uniform(-6e-3, 6e-3))),
        opens_s=robot.opens_s + late, closes_s=robot.closes_s + late,
    )  # fmt: skip


def wrench_of(robot: Robot, open_share: Array) -> Array:
    """Force in the vehicle's axes and torque about the centre of mass, shape (n, 3).

    Args:
        robot: the vehicle.
        open_share: of each jet, shape (n, jets), 0 to 1.
    """
    crowd = np.maximum(open_share.sum(axis=1) - 1.0, 0.0)
    each = open_share / (1.0 + robot.droop * crowd)[:, None]
    columns = []
    for jet in robot.jets:
        fx, fy = jet.force * np.cos(jet.angle), jet.force * np.sin(jet.angle)
        columns.append((fx, fy, (jet.x - robot.com[0]) * fy - (jet.y - robot.com[1]) * fx))
    return np.asarray(each @ np.array(columns))


def commands(
    robot: Robot, lab: Lab, seconds: float, rng: np.random.Generator, lively: float = 1.0
) -> Array:
    """Duty of each jet in each period, shape (periods, jets): pushes that keep the vehicle near.

    A pilot tries some pushes in thought and takes the one after which the vehicle is slow and near.
    """
    count, jets = round(seconds / PERIOD), len(robot.jets)
    duty = np.zeros((count, jets))
    at, speed, heading, rate = np.zeros(2), np.zeros(2), 0.0, 0.0
    k = 0
    while k < count:
        held, rest = int(rng.integers(2, 9)), int(rng.integers(0, 5))
        tries = np.zeros((24, jets))
        for row in tries:
            row[rng.choice(jets, int(rng.integers(1, 4)), replace=False)] = lively
        tries *= rng.uniform(0.25, 1.0, tries.shape)
        push = wrench_of(robot, tries)
        cost = []
        for fx, fy, tau in push:
            c, s = np.cos(heading), np.sin(heading)
            gain = held * PERIOD * np.array([c * fx - s * fy, s * fx + c * fy]) / robot.mass
            v, w = speed + gain, rate + held * PERIOD * tau / robot.inertia
            ahead = at + 4.0 * v
            cost.append(ahead @ ahead + 5.0 * v @ v + 0.5 * w * w + 0.3 * rng.random())
        best = int(np.argmin(cost))
        for step in range(held + rest):
            fx, fy, tau = push[best] * (step < held)
            c, s = np.cos(heading), np.sin(heading)
            force = np.array([c * fx - s * fy, s * fx + c * fy])
            speed = speed + PERIOD * (force / robot.mass + np.array(lab.slope))
            rate += PERIOD * tau / robot.inertia
            at, heading = at + PERIOD * speed, heading + PERIOD * rate
        duty[k : k + held] = tries[best]
        k += held + rest
    return duty


def opened(robot: Robot, duty: Array, t: Array) -> Array:
    """How far each valve is open at the times `t`, shape (n, jets)."""
    found = np.zeros((len(t), duty.shape[1]))
    for j, column in enumerate(duty.T):
        up = PERIOD * np.flatnonzero(column > 0.0)
        down = up + PERIOD * column[column > 0.0]
        joined = np.append(False, up[1:] - down[:-1] < 1e-9)  # one pulse over several periods
        up, down = up[~joined], down[np.append(~joined[1:], True)] if len(up) else down
        for a, b in zip(up + robot.opens_s, down + robot.closes_s, strict=True):
            part = slice(*np.searchsorted(t, (a, b + robot.ramp_s)))
            edges = [a, a + robot.ramp_s, b, b + robot.ramp_s]
            flow = np.interp(t[part], edges, [0.0, 1.0, 1.0, 0.0])
            found[part, j] = np.maximum(found[part, j], flow)
    return found


def integral(rate: Array, start: float = 0.0) -> Array:
    """Integral over the grid by Simpson's rule: `rate` has a point in the middle of each step."""
    pieces = (rate[:-2:2] + 4.0 * rate[1:-1:2] + rate[2::2]) * STEP / 6.0
    return np.append(start, start + np.cumsum(pieces))


def between(values: Array) -> Array:
    """Values at the ends of the steps, and by a cubic in their middles."""
    full = np.zeros(2 * len(values) - 1)
    full[::2] = values
    wide = np.concatenate([[2 * values[0] - values[1]], values, [2 * values[-1] - values[-2]]])
    full[1::2] = (9.0 * (wide[1:-2] + wide[2:-1]) - wide[:-3] - wide[3:]) / 16.0
    return full


def flight(robot: Robot, lab: Lab, duty: Array, t: Array) -> Array:
    """True poses of the markers' origin at the times `t`, from rest, shape (n, 3)."""
    count = int(np.ceil((len(duty) * PERIOD + 0.2) / STEP))
    fine = 0.5 * STEP * np.arange(2 * count + 1)  # ends and middles of the steps
    valves = opened(robot, duty, fine)
    wrench = wrench_of(robot, valves)
    crowd = np.maximum(valves.sum(axis=1) - 1.0, 0.0)
    strength = valves @ [jet.force for jet in robot.jets] / (1.0 + robot.droop * crowd)
    mass = robot.mass - between(integral(strength / robot.exhaust))
    rate = between(integral(wrench[:, 2] / robot.inertia))
    heading = between(integral(rate))
    c, s = np.cos(heading), np.sin(heading)
    ax = (c * wrench[:, 0] - s * wrench[:, 1]) / mass + lab.slope[0]
    ay = (s * wrench[:, 0] + c * wrench[:, 1]) / mass + lab.slope[1]
    x, y = (integral(between(integral(a))) for a in (ax, ay))
    cx, cy = robot.com  # the origin was at 0, 0
    x = x + cx - (c * cx - s * cy)[::2]
    y = y + cy - (s * cx + c * cy)[::2]
    ends = fine[::2]
    return np.stack([np.interp(t, ends, one) for one in (x, y, heading[::2])], axis=1)


class Written(NamedTuple):
    """How a lab writes its log: what its mapping says, and the factors of its units."""

    heading: str = "rad"  # rad, deg, or quaternion
    metre: float = 1.0  # units of length in a metre
    second: float = 1.0  # units of time in a second
    kind: str = "duty"  # duty or us
    start: float = 0.0  # [s] the clock at the first row
    middle: tuple[float, float] = (0.0, 0.0)  # [m]


def write_log(path: Path, duty: Array, poses: Array, t: Array, how: Written) -> None:
    """A CSV with a row per camera frame: time, pose, and the command of the period."""
    jets = duty.shape[1]
    x, y = ((poses[:, k] + how.middle[k]) * how.metre for k in (0, 1))
    turned = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    columns = [("time", (t + how.start) * how.second), ("x", x), ("y", y)]
    if how.heading == "quaternion":
        half = 0.5 * turned
        columns += [("qw", np.cos(half)), ("qx", 0 * t), ("qy", 0 * t), ("qz", np.sin(half))]
    else:
        columns += [("yaw", np.degrees(turned) if how.heading == "deg" else turned)]
    now = np.minimum((t / PERIOD + 1e-6).astype(int), len(duty) - 1)
    factor = 1.0 if how.kind == "duty" else 1e6 * PERIOD
    columns += [(f"jet{j + 1}", factor * duty[now, j]) for j in range(jets)]
    names, values = zip(*columns, strict=True)
    form = ["%.16g"] + ["%.9g"] * (len(names) - 1)
    np.savetxt(path, np.stack(values, axis=1), form, ",", header=",".join(names), comments="")


def mapping_of(jets: int, lab: Lab, how: Written) -> str:
    """The mapping file of such a log."""
    heading = 'theta = "yaw"'
    if how.heading == "deg":
        heading += '\nangle_unit = "deg"'
    elif how.heading == "quaternion":
        heading = 'quaternion = ["qx", "qy", "qz", "qw"]'
    length = {1.0: "m", 100.0: "cm", 1000.0: "mm"}[how.metre]
    unit = {1.0: "s", 1e3: "ms", 1e6: "us", 1e9: "ns"}[how.second]
    return f"""
[time]
column = "time"
unit = "{unit}"
[pose]
x = "x"
y = "y"
{heading}
unit = "{length}"
middle = [{how.middle[0]}, {how.middle[1]}]
latency_s = {lab.latency}
[valves]
columns = [{", ".join(f'"jet{j + 1}"' for j in range(jets))}]
period_s = {PERIOD}
kind = "{how.kind}"
"""


def vehicle_file(robot: Robot) -> str:
    """The lab's drawing of the vehicle, as a vehicle file."""
    jets = "\n".join(
        f"  {{ position = [{j.x!r}, {j.y!r}], thrust = {j.force!r},"
        f" push = [{float(np.cos(j.angle))!r}, {float(np.sin(j.angle))!r}] }},"
        for j in robot.jets
    )
    return f"""
mass = {robot.mass}
inertia = {robot.inertia}
com = [{robot.com[0]}, {robot.com[1]}]
radius = 0.3
command_delay_s = 0.0
drag = 0.0
spin_drag = 0.0
jets = [
{jets}
]
[valve]
open_delay_s = {robot.opens_s}
close_delay_s = {robot.closes_s}
open_ramp_s = {robot.ramp_s}
close_ramp_s = {robot.ramp_s}
min_on_s = 0.01
min_off_s = 0.01
[air]
gas = 0.3
tank_pressure = 20.0e6
tank_position = [0.0, 0.0]
set_pressure = 0.5e6
dropout = 0.1e6
exhaust_speed = {robot.exhaust}
droop = {robot.droop}
bearing_flow = 1.0e-9
[tolerance]
thrust = 0.08
direction_deg = 1.0
pulse = 0.005
mass = 0.01
inertia = 0.1
com = 0.005
"""
