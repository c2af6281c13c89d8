"""Effects of gas consumption: supply pressure, mass, centre of mass, inertia."""

from sim_twin.body import CX, CY, FX, INERTIA, MASS, A, B, C
from testbed.core.compiled import inlined

PASSES = 12
FLOW, SHARE = range(2)  # columns of `Stages.gas`


@inlined
def supply_share(parameters, v, used):
    """Supply pressure over set pressure of vehicle `v` after `used` kg of gas, isothermal tank."""
    left = max(0.0, parameters.gas[v] - used)
    tank = parameters.tank_pressure[v] * left / parameters.gas[v]
    supply = max(0.0, min(parameters.set_pressure[v], tank - parameters.dropout[v]))
    return supply / parameters.set_pressure[v]


@inlined
def body_now(parameters, v, used):
    """Mass, inertia about the centre of mass, and centre of mass (x, y) after `used` kg of gas.

    The gas is modelled as a point mass at the tank.
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
def breathe(stages, level, rate, since, h, parameters, v, used):
    """Wrench, mass properties and gas flow of vehicle `v` at the Gauss points, see `body.step`.

    The consumed gas is a state of the same collocation step: the flow depends on the supply
    pressure, which depends on the remaining gas.

    Args:
        stages: `body` and `gas` are written to.
        level: fx, fy, tau and sum of thrust magnitudes at set pressure, when their piece began.
        rate: their slopes.
        since: the piece began so long before the step [s].
        h: step [s].
        parameters: the true vehicles.
        v: index of the vehicle.
        used: gas consumed at the start [kg].

    Returns:
        gas consumed at the end [kg], total impulse of all jets [N s].
    """
    body, gas = stages.body, stages.gas
    flow = level[3] + rate[3] * since
    gas[:] = 0.0
    for _ in range(PASSES):
        change = 0.0
        for i in range(3):
            gone = used
            for j in range(3):
                gone += h * A[i, j] * gas[j, FLOW]
            gas[i, SHARE] = supply_share(parameters, v, gone)
            new = gas[i, SHARE] * (flow + C[i] * h * rate[3]) / parameters.exhaust_speed[v]
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
            now = level[axis] + rate[axis] * since
            body[i, FX + axis] = gas[i, SHARE] * (now + C[i] * h * rate[axis])
        mass, inertia, cx, cy = body_now(parameters, v, min(gone, parameters.gas[v]))
        body[i, MASS], body[i, INERTIA], body[i, CX], body[i, CY] = mass, inertia, cx, cy
        end += h * B[i] * gas[i, FLOW]
        impulse += h * B[i] * gas[i, SHARE] * (flow + C[i] * h * rate[3])
    return min(end, parameters.gas[v]), impulse
