"""The shipped vehicle and table, and hypothesis without chance and without a clock."""

import msgspec
import pytest
from hypothesis import settings

from testbed.config import SHIPPED, read_toml
from testbed.core.table import Table
from testbed.core.types import Accel, Pose, State, Twist
from testbed.core.vehicle import Vehicle

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")


@pytest.fixture(scope="session")
def vehicle():
    return msgspec.convert(read_toml(SHIPPED / "vehicles" / "generic_8jet.toml"), Vehicle)


@pytest.fixture(scope="session")
def table():
    return msgspec.convert(read_toml(SHIPPED / "tables" / "marble_6m.toml"), Table)


@pytest.fixture(scope="session")
def make_state():
    """A healthy estimate from (x, y, theta), (vx, vy, omega) and (ax, ay, alpha)."""

    def make(pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0), bias=(0.0, 0.0, 0.0), t=0.0):
        return State(t, Pose(*pose), Twist(*twist), Accel(*bias), pose_age=0.02, rejected=0)

    return make
