"""The shipped vehicle, and hypothesis without chance and without a clock."""

import msgspec
import pytest
from hypothesis import settings

from testbed.config import SHIPPED, read_toml
from testbed.core.vehicle import Vehicle

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")


@pytest.fixture(scope="session")
def shipped_vehicle():
    return msgspec.convert(read_toml(SHIPPED / "vehicles" / "generic_8jet.toml"), Vehicle)
