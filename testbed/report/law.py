"""The section on the law of a report."""

from pathlib import PurePath

from testbed.config.experiment import Experiment


def law_of(scenario: Experiment) -> str:
    """The law's name in an experiment file; for a user-defined law, its file and name."""
    own = getattr(scenario.controller, "law", None)
    if isinstance(own, str):
        return PurePath(own).name
    return str(type(scenario.controller).__struct_config__.tag)


def range_of(scenario: Experiment) -> float | None:
    """Communication range that the law assumes [m]; None if it assumes none."""
    formation = getattr(scenario.controller, "formation", scenario.controller)
    found = getattr(formation, "range", None)
    scale = getattr(scenario.controller, "scale", None)
    if not isinstance(found, float):
        return None
    return found / scale.length if scale is not None else found
