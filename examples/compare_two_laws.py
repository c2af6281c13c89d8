"""Compare two laws on the same experiment and the same seed."""

import testbed

hold = testbed.load("hold", seed=2)
laws = {
    "pd": hold.with_(controller={"type": "pd", "bandwidth": 0.2}),
    "lqr": hold.with_(controller={"type": "lqr"}),
}
print(f"{'law':<6}{'settled [s]':>12}{'hold RMS [mm]':>15}{'impulse [N s]':>15}")
for name, experiment in laws.items():
    sat1 = testbed.fly(experiment).metrics.vehicles["sat1"]
    settled = "-" if sat1.settle_s is None else f"{sat1.settle_s:.1f}"
    print(f"{name:<6}{settled:>12}{1e3 * sat1.hold_rms_m:>15.2f}{sat1.impulse_ns:>15.2f}")
