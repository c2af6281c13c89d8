"""What leaving gas changes: supply pressure, mass, centre of mass, inertia."""

from testbed.core.compiled import compiled


@compiled
def supply_share(metal, v, used):
    """Supply pressure over set pressure of vehicle `v` with `used` kg gone, isothermal tank."""
    left = max(0.0, metal.gas[v] - used)
    tank = metal.tank_pressure[v] * left / metal.gas[v]
    supply = max(0.0, min(metal.set_pressure[v], tank - metal.dropout[v]))
    return supply / metal.set_pressure[v]


@compiled
def body_now(metal, v, used):
    """Mass, inertia about the centre of mass, and centre of mass (x, y) with `used` kg gone.

    The gas is a point mass at the tank: it takes its share of the moments with it.
    """
    mass = metal.mass[v] - used
    share = used / mass
    ox = metal.com[v, 0] - metal.tank[v, 0]
    oy = metal.com[v, 1] - metal.tank[v, 1]
    cx = metal.com[v, 0] + share * ox
    cy = metal.com[v, 1] + share * oy
    # parallel axes: body with gas about the old centre = remainder about it + the gas that left
    inertia = metal.inertia[v] - used * (ox * ox + oy * oy) * (1.0 + share)
    return mass, inertia, cx, cy
