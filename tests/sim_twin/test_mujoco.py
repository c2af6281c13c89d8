"""The plant against somebody else's physics: with its step, MuJoCo's distance from us vanishes."""

import os

import numpy as np
import pytest

if os.environ.get("CI") == "true":
    import mujoco
else:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra 'dev')")

SECONDS = 5
# All times of the flow are multiples of the coarsest step, so that it errs by its order only.
STEPS_MS = (4, 2, 1)
LATE_MS, DELAY_MS, RAMP_MS = 2, 6, 4  # plan to board, valve's dead time, valve's ramp
RAMPS = {"open_ramp_s": 0.004, "close_ramp_s": 0.004}


def scene(vehicle):
    """A free planar body; every jet is an actuator that pushes at its nozzle."""
    sites, motors = [], []
    for j, jet in enumerate(vehicle.jets):
        fx, fy = jet.thrust * np.array(jet.push)
        sites.append(f'<site name="jet{j}" pos="{jet.position[0]} {jet.position[1]} 0"/>')
        motors.append(f'<general site="jet{j}" gear="{fx} {fy} 0 0 0 0"/>')
    cx, cy = vehicle.com
    return f"""
    <mujoco>
      <option gravity="0 0 0"/>
      <worldbody>
        <body>
          <joint type="slide" axis="1 0 0"/>
          <joint type="slide" axis="0 1 0"/>
          <joint type="hinge" axis="0 0 1"/>
          <inertial pos="{cx} {cy} 0" mass="{vehicle.mass}" diaginertia="1 1 {vehicle.inertia}"/>
          {"".join(sites)}
        </body>
      </worldbody>
      <actuator>{"".join(motors)}</actuator>
    </mujoco>"""


def levels(pulses, droop, times):
    """Share of its nominal thrust that each jet has at `times`; pulses as (jet, up, down) [ms]."""
    flow = np.zeros((len(times), 8))
    for jet, up, down in pulses:
        rising, falling = times - (up + DELAY_MS), (down + DELAY_MS + RAMP_MS) - times
        flow[:, jet] += np.clip(np.minimum(rising, falling) / RAMP_MS, 0.0, 1.0)
    open_jets = np.maximum((flow > 0.0).sum(axis=1), 1)
    return flow / (1.0 + droop * (open_jets - 1))[:, None]


@pytest.fixture(scope="module")
def vehicle(make_vehicle):
    return make_vehicle(com=(0.02, -0.03), valve=RAMPS)


@pytest.fixture(scope="module")
def pulses():
    """Three jets in each period."""
    rng, drawn = np.random.default_rng(11), []
    for k in range(10 * SECONDS):
        for jet in rng.choice(8, 3, replace=False).tolist():
            up = 100 * k + 4 * int(rng.integers(3, 13))
            drawn.append((jet, up, up + 4 * int(rng.integers(4, 10))))
    return drawn


@pytest.fixture(scope="module", params=[0.0, 2.0], ids=["at rest", "spinning"])
def flown(request, make_plant, make_plan, vehicle, pulses):
    """The plant's start and end."""
    start = [0.1, -0.2, 0.3, 0.02, 0.05, request.param]
    plant = make_plant([vehicle], [start])
    for k in range(10 * SECONDS):
        now = [(jet, up - 100 * k, down - up) for jet, up, down in pulses if up // 100 == k]
        plan = {jet: (offset * 1e-3, on * 1e-3) for jet, offset, on in now}
        plant.boards["0"].apply(make_plan(0.1 * k, plan))
        plant.advance(0.1 * (k + 1))
    assert plant.touches == []
    return start, plant.x[0]


@pytest.fixture(scope="module")
def fly_mujoco(vehicle, pulses):
    model = mujoco.MjModel.from_xml_string(scene(vehicle))

    def fly(start, step_ms):
        model.opt.timestep = step_ms * 1e-3
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start[:3], start[3:]
        times = np.arange(0.0, 1000.0 * SECONDS, step_ms)
        for level in levels(pulses, vehicle.air.droop, times - LATE_MS):
            data.ctrl[:] = level
            mujoco.mj_step(model, data)
        return np.concatenate([data.qpos, data.qvel])

    return fly


def test_mujoco_comes_closer_in_first_order(flown, fly_mujoco):
    start, end = flown
    coarse, middle, fine = (fly_mujoco(start, step) for step in STEPS_MS)
    error = np.array([np.linalg.norm(x[:3] - end[:3]) for x in (coarse, middle, fine)])
    assert error[:-1] / error[1:] == pytest.approx([2.0, 2.0], abs=0.02)
    # without the terms in h and h^2 there is nearly nothing left
    limit = (8.0 * fine - 6.0 * middle + coarse) / 3.0
    assert np.linalg.norm(limit[:3] - end[:3]) < 1e-8
