"""Reads an experiment file and the files it refers to into typed, frozen structs.

There is one TOML file per experiment, vehicle and table. `table` and a vehicle's `model` are paths,
relative to the referring file, or inline tables. The resolved experiment has everything inline and
is a file of the same form. `key=value` overrides are TOML, too.

Every error is a `ConfigError` that says where, what was expected and what was found.
"""

from testbed.config.error import ConfigError
from testbed.config.experiment import Deploy, Experiment, Fork, VehicleSetup
from testbed.config.file import dump, find, load, loads
from testbed.config.shipped import SHIPPED
from testbed.config.tree import read_toml

__all__ = [
    "SHIPPED",
    "ConfigError",
    "Deploy",
    "Experiment",
    "Fork",
    "VehicleSetup",
    "dump",
    "find",
    "load",
    "loads",
    "read_toml",
]
