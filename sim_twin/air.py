"""What leaving gas changes: supply pressure, mass, centre of mass, inertia."""

from sim_twin.body import CX, CY, FX, INERTIA, MASS, A, B, C
from testbed.core.compiled import inlined

PASSES = 12
FLOW, SHARE = range(2)  # columns of `Stages.gas`


@inlined
def supply_share(parameters, v, used):
    """Supply pressure over set pressure of vehicle `v` with `used` kg gone, isothermal tank."""
    left = max(0.0, parameters.gas[v] - used)
    tank = parameters.tank_pressure[v] * left / parameters.gas[v]
    supply = max(0.0, min(parameters.set_pressure[v], tank - parameters.dropout[v]))
    return supply / parameters.set_pressure[v]


@inlined
def body_now(parameters, v, used):
    """Mass, inertia about the centre of mass, and centre of mass (x, y) with `used` kg gone.

    The gas is a point mass at the tank: it takes its share of the moments with it.
    """
    mass = parameters.mass[v] - used
    share = used / mass
    ox = parameters.com[v, 0] - parameters.tank[v, 0]
    oy = parameters.com[v, 1] - parameters.tank[v, 1]
    cx = parameters.com[v, 0] + share * ox
    cy = parameters.com[v, 1] + share * oy
    # parallel axes: body with gas about the old centre = remainder about it + the gas that left
    inertia = parameters.inertia[v] - used * (ox * ox + oy * oy) * (1.0 + share)
    return mass, inertia, cx, cy


@inlined
def breathe(stages, now, rate, h, parameters, v, used):
    """What vehicle `v` is at the three Gauss points of a step, see `body.step`.

    The gas that has left by then is a state of the same collocation step: flow depends on the
    supply pressure, and that on the gas that is left.

    Args:
        stages: `body` and `gas` are written to.
        now: fx, fy, tau and sum of thrust magnitudes at the start, at set pressure.
        rate: their slopes.
        h: [s].
        parameters: the true vehicles.
        v: number of the vehicle.
        used: gas gone at the start [kg].

    Returns:
        gas gone at the end [kg], impulse of all jets together [N s].
    """
    body, gas = stages.body, stages.gas
    gas[:] = 0.0
    for _ in range(PASSES):
        change = 0.0
        for i in range(3):
            gone = used
            for j in range(3):
                gone += h * A[i, j] * gas[j, FLOW]
            gas[i, SHARE] = supply_share(parameters, v, gone)
            new = gas[i, SHARE] * (now[3] + C[i] * h * rate[3]) / parameters.exhaust_speed[v]
            if gone < parameters.gas[v]:
                new += parameters.bearing_flow[v]
            change = max(change, abs(new - gas[i, FLOW]))
            gas[i, FLOW] = new
        if change < 1e-18:
            break
    end, impulse = used, 0.0
    for i in range(3):
        gone = used
        for j in range(3):
            gone += h * A[i, j] * gas[j, FLOW]
        for axis in range(3):
            body[i, FX + axis] = gas[i, SHARE] * (now[axis] + C[i] * h * rate[axis])
        mass, inertia, cx, cy = body_now(parameters, v, min(gone, parameters.gas[v]))
        body[i, MASS], body[i, INERTIA], body[i, CX], body[i, CY] = mass, inertia, cx, cy
        end += h * B[i] * gas[i, FLOW]
        impulse += h * B[i] * gas[i, SHARE] * (now[3] + C[i] * h * rate[3])
    return min(end, parameters.gas[v]), impulse
