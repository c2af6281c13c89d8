"""Hardware-in-the-loop testbed for satellite simulators on a planar air-bearing table.

    import testbed

    run = testbed.fly(testbed.load("hold", seed=3))
    run.passed, run["sat1"].pose

`load` an experiment, `fly` it, `fly_many`, `open_run` a folder, `replay` or `fork` a run, `sweep` a
parameter, `predict` a motion, or drive the `Twin` tick by tick. Names are imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.campaign.fly_many import fly_many
    from testbed.campaign.parameter_sweep import sweep
    from testbed.core.error import TestbedError
    from testbed.core.law import Law
    from testbed.identification.prediction import Valves, Wrenches, predict
    from testbed.run.api import InterruptedFlight, fly, fork, open_run, replay
    from testbed.run.experiment import Experiment, load
    from testbed.run.flown import Run
    from testbed.run.stepper import Twin
    from testbed.run.table import Table

_HOMES = {
    "Experiment": "testbed.run.experiment",
    "InterruptedFlight": "testbed.run.api",
    "Law": "testbed.core.law",
    "Run": "testbed.run.flown",
    "Table": "testbed.run.table",
    "TestbedError": "testbed.core.error",
    "Twin": "testbed.run.stepper",
    "Valves": "testbed.identification.prediction",
    "Wrenches": "testbed.identification.prediction",
    "fly": "testbed.run.api",
    "fly_many": "testbed.campaign.fly_many",
    "fork": "testbed.run.api",
    "load": "testbed.run.experiment",
    "open_run": "testbed.run.api",
    "predict": "testbed.identification.prediction",
    "replay": "testbed.run.api",
    "sweep": "testbed.campaign.parameter_sweep",
}
__all__ = [
    "Experiment",
    "InterruptedFlight",
    "Law",
    "Run",
    "Table",
    "TestbedError",
    "Twin",
    "Valves",
    "Wrenches",
    "fly",
    "fly_many",
    "fork",
    "load",
    "open_run",
    "predict",
    "replay",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'testbed' has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
