"""Fly a law of your own: this file is the law, and the script that flies it."""

from typing import Annotated

from msgspec import Meta, Struct

import testbed

Positive = Annotated[float, Meta(gt=0.0)]


class Spring(Struct, frozen=True):
    """A damped spring to the goal."""

    stiffness: Positive = 0.02  # [1/s^2]
    damping: Positive = 0.28  # [1/s]
    step_s: Positive = 0.02  # time between two calls of `force`

    def force(self, own, neighbours, world, t):
        """Force in the table frame, shape (2,) [N]."""
        pull = self.stiffness * (world.goal.p - own.p)
        return own.mass * (pull - self.damping * own.v - own.disturbance)


if __name__ == "__main__":
    law = {"type": "python", "law": f"{__file__}:Spring", "parameters": {"damping": 0.25}}
    hold = testbed.load("hold", seed=1)
    run = testbed.fly(hold.with_(controller=law, criteria={}))
    print(run)
    print(f"final error: {1e3 * run.metrics.vehicles['sat1'].final_error_m:.1f} mm")
