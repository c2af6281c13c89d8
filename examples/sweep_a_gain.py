"""Fly one experiment with several gains on several seeds, in two processes."""

import testbed

hold = testbed.load("hold")
runs = testbed.sweep(hold, over={"controller.bandwidth": [0.1, 0.2, 0.3]}, seeds=range(3), jobs=2)
for bandwidth in (0.1, 0.2, 0.3):
    rows = runs["controller.bandwidth"] == bandwidth
    passed = (runs["outcome"][rows] == "passed").mean()
    print(
        f"{bandwidth:.1f} rad/s: {passed:.0%} passed, "
        f"settled after {runs['settle_s'][rows].max():.1f} s, "
        f"impulse {runs['impulse_ns'][rows].mean():.2f} N s"
    )
