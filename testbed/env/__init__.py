"""Environments for learning on the twin: Gymnasium for one vehicle, PettingZoo for several.

    from testbed.env import TableEnv, FleetEnv, table_envs      # extra `learn`

    env = TableEnv(testbed.load("configs/scenarios/step.toml"), action="force")
    seen, info = env.reset(seed=1)

docs/learning.md describes actions, observations, reward and endings.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from testbed.core.error import TestbedError
from testbed.core.extra import pip_install

if TYPE_CHECKING:
    from testbed.env.fleet import FleetEnv
    from testbed.env.table import TableEnv
    from testbed.env.vector import table_envs

_HOMES = {
    "FleetEnv": "testbed.env.fleet",
    "TableEnv": "testbed.env.table",
    "table_envs": "testbed.env.vector",
}
__all__ = ["FleetEnv", "TableEnv", "table_envs"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'testbed.env' has no attribute {name!r}")
    try:
        return getattr(import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        raise TestbedError(
            where="testbed.env", expected=f"the extra `learn`: {pip_install('learn')}",
            found=f"the package `{error.name}` is not installed",
        ) from None  # fmt: skip
