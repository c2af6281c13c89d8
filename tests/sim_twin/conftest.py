"""Vehicles, tables and plans for the twin's tests, made from the shipped files."""

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from sim_twin.plant import Plant
from testbed.config import SHIPPED, read_toml
from testbed.core.table import Table
from testbed.core.types import Pose, ValveCommand
from testbed.core.vehicle import Tolerance, Vehicle

NEVER_AGED = {"exhaust_speed": 1e30, "bearing_flow": 0.0}  # gas that weighs nothing
AS_DRAWN = dict.fromkeys(Tolerance.__struct_fields__, 0.0)
LEVEL = {"uniform": (0.0, 0.0), "map": []}


def changed(struct, **changes):
    """A copy of `struct`; a dictionary changes some fields of a nested struct."""
    return replace(
        struct,
        **{
            name: changed(getattr(struct, name), **value) if isinstance(value, dict) else value
            for name, value in changes.items()
        },
    )


@pytest.fixture(scope="session")
def shipped_vehicle():
    return msgspec.convert(read_toml(SHIPPED / "vehicles" / "generic_8jet.toml"), Vehicle)


@pytest.fixture(scope="session")
def shipped_table():
    return msgspec.convert(read_toml(SHIPPED / "tables" / "marble_6m.toml"), Table)


@pytest.fixture(scope="session")
def make_vehicle(shipped_vehicle):
    """The shipped vehicle exactly as drawn and with weightless gas, then `changes`."""
    ideal = changed(shipped_vehicle, tolerance=AS_DRAWN, air=NEVER_AGED)
    return lambda **changes: changed(ideal, **changes)


@pytest.fixture(scope="session")
def make_table(shipped_table):
    """The shipped table made level, then `changes`."""
    level = changed(shipped_table, tilt=LEVEL)
    return lambda **changes: changed(level, **changes)


@pytest.fixture(scope="session")
def make_plant(make_table):
    """A plant of vehicles (called 0, 1, ...) that start with the given states, shape (v, 6)."""

    def make(vehicles, states, table=None, obstacles=None, seed=0):
        fleet = {str(k): vehicle for k, vehicle in enumerate(vehicles)}
        starts = {name: Pose(0.0, 0.0, 0.0) for name in fleet}
        plant = Plant(fleet, starts, table or make_table(), obstacles or {}, seed)
        plant.x[:] = np.asarray(states, dtype=float)
        return plant

    return make


@pytest.fixture(scope="session")
def make_plan():
    """A plan for eight jets from {jet: (offset, on)} in seconds."""

    def make(t, pulses, lifetime=0.1):
        on, offset = [0] * 8, [0] * 8
        for jet, (start, width) in pulses.items():
            offset[jet], on[jet] = round(start * 1e6), round(width * 1e6)
        return ValveCommand(0, t, t + lifetime, tuple(on), tuple(offset))

    return make
