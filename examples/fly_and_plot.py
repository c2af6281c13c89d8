"""Fly an experiment on the twin, print its numbers, save the report's figures."""

import numpy as np

import testbed

run = testbed.fly(testbed.load("hold", seed=3))
sat1 = run["sat1"]
error_m = np.hypot(*(sat1.pose - sat1.reference)[:, :2].T)  # NaN before the first pose

print(run)
print(f"largest distance from the reference: {1e3 * np.nanmax(error_m):.2f} mm")
print(f"open time of jet 1: {1e-6 * sat1.on_us[:, 0].sum():.2f} s")
for path in run.plot("trajectory", "error", "valves").save("figures"):
    print(path)
