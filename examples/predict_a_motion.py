"""Predict a motion with the plant alone: two pulses, and how far a wrong delay leads astray."""

import numpy as np
from msgspec.structs import replace

import testbed

vehicle = testbed.load("hold").vehicles["sat1"].model
late = replace(vehicle, command_delay_s=vehicle.command_delay_s + 0.05)
inputs = testbed.Valves(
    up=np.array([0.0, 0.5]), down=np.array([0.4, 0.7]), jet=np.array([0, 2])
)  # [s]; jet 0 is jet 1 of the file
times = np.arange(0.0, 3.1, 0.5)  # [s]
at_rest = np.zeros(6)  # x, y, theta, vx, vy, omega

states = testbed.predict(vehicle, None, inputs, at_rest, times)
others = testbed.predict(late, None, inputs, at_rest, times)
for t, state, other in zip(times, states, others, strict=True):
    x, y = 1e3 * state[:2]
    off = 1e3 * np.hypot(*(other - state)[:2])
    print(f"{t:.1f} s: x {x:6.1f} mm, y {y:6.1f} mm; 50 ms later {off:.1f} mm off")
