"""An experiment file and all it refers to, read into typed frozen structs.

One TOML per experiment, vehicle and table. A `table` or a vehicle's `model` is a path, relative to
the file that says so, or the table itself written in place; the resolved experiment has everything
in place and is a file of the same form. `key=value` overrides are TOML too.

Whatever is wrong is one `ConfigError` that says where, what was expected and what was found.
"""

from testbed.config.error import ConfigError
from testbed.config.experiment import Deploy, Experiment, VehicleSetup
from testbed.config.file import SHIPPED, dump, find, load, loads
from testbed.config.tree import read_toml

__all__ = [
    "SHIPPED",
    "ConfigError",
    "Deploy",
    "Experiment",
    "VehicleSetup",
    "dump",
    "find",
    "load",
    "loads",
    "read_toml",
]
