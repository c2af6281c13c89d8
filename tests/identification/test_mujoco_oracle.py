"""`predict` beside MuJoCo, another integrator of the same forces; skipped without MuJoCo."""

import numpy as np
import pytest
from msgspec import structs

from testbed.identification.prediction import predict, pulses

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an optional oracle and not installed")

PERIOD, SECONDS, STEP = 0.1, 6.0, 5e-4

WORLD = """
<mujoco>
  <option timestep="{step}" gravity="{gx} {gy} 0" integrator="RK4"/>
  <worldbody><body name="b">
    <joint type="slide" axis="1 0 0" damping="{drag}"/>
    <joint type="slide" axis="0 1 0" damping="{drag}"/>
    <joint type="hinge" axis="0 0 1" damping="{spin}"/>
    <inertial pos="{cx} {cy} 0" mass="{mass}" diaginertia="1 1 {inertia}"/>
    {sites}
  </body></worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""


def flown_by_mujoco(vehicle, share, slope, x0):
    """States at the end of each period; the valves are ideal."""
    sites = "".join(
        f'<site name="s{k}" pos="{j.position[0]} {j.position[1]} 0"/>'
        for k, j in enumerate(vehicle.jets)
    )
    motors = "".join(
        f'<motor site="s{k}" gear="{j.thrust * j.push[0]} {j.thrust * j.push[1]} 0 0 0 0"/>'
        for k, j in enumerate(vehicle.jets)
    )
    model = mujoco.MjModel.from_xml_string(
        WORLD.format(
            step=STEP, gx=slope[0], gy=slope[1], drag=vehicle.drag, spin=vehicle.spin_drag,
            cx=vehicle.com[0], cy=vehicle.com[1], mass=vehicle.mass, inertia=vehicle.inertia,
            sites=sites, motors=motors,
        )
    )  # fmt: skip
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = x0[:3], x0[3:]
    seen = []
    for row in share:
        count = round(PERIOD / STEP)
        for k in range(count):
            data.ctrl[:] = row > (k + 0.5) / count
            mujoco.mj_step(model, data)
        seen.append([*data.qpos, *data.qvel])
    return np.array(seen)


@pytest.mark.parametrize(
    ("com", "drag", "spin"),
    [((0.004, -0.006), 0.0, 0.0), ((0.0, 0.0), 1.8, 0.3)],  # drag acts on the centre of mass
)
def test_predict_agrees_with_mujoco(floater, table, com, drag, spin):
    valve = structs.replace(
        floater.valve, open_delay_s=0.0, close_delay_s=0.0, open_ramp_s=1e-6, close_ramp_s=1e-6
    )
    air = structs.replace(floater.air, droop=0.0, bearing_flow=0.0, exhaust_speed=1e9)
    vehicle = structs.replace(
        floater, valve=valve, air=air, com=com, command_delay_s=0.0, drag=drag,
        spin_drag=spin,
    )  # fmt: skip
    tilt = structs.replace(table.tilt, uniform=(3e-3, -2e-3), map=[])
    ground = structs.replace(table, tilt=tilt)
    rng = np.random.default_rng(3)
    count = round(SECONDS / PERIOD)
    share = np.where(rng.random((count, 8)) < 0.3, rng.integers(1, 10, (count, 8)) / 10.0, 0.0)
    x0 = np.array([0.1, -0.2, 0.5, 0.03, -0.02, 0.1])
    t = PERIOD * np.arange(count + 1)
    own = predict(vehicle, ground, pulses(t[:-1], share, PERIOD), x0, t)[1:]
    theirs = flown_by_mujoco(vehicle, share, (3e-3, -2e-3), x0)
    np.testing.assert_allclose(own[:, :3], theirs[:, :3], atol=5e-5)
    np.testing.assert_allclose(own[:, 3:], theirs[:, 3:], atol=5e-5)
