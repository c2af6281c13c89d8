"""Drive the twin tick by tick with a loop of your own: a damped spring as five lines."""

import testbed

hold = testbed.load("hold", seed=4)
twin = testbed.Twin(hold)
setup = hold.vehicles["sat1"]
force = (0.0, 0.0)
while twin.t < 60.0:
    state = twin.step({"sat1": force})["sat1"].outputs.state
    if state is not None:  # the first pose has arrived
        ex, ey = setup.goal[0] - state.pose.x, setup.goal[1] - state.pose.y
        ax = 0.02 * ex - 0.28 * state.twist.vx - state.bias.ax  # the slope's acceleration too
        ay = 0.02 * ey - 0.28 * state.twist.vy - state.bias.ay
        force = (setup.model.mass * ax, setup.model.mass * ay)
x, y, theta, *_ = twin.true_state("sat1")
print(f"after {twin.t:.0f} s: x {1e3 * x:.1f} mm, y {1e3 * y:.1f} mm, heading {theta:.3f} rad")
print(f"contacts: {twin.contacts}")
