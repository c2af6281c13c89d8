"""Which numbers a run does not measure, and warnings about criteria that need them."""

from controllers.graph import formation_kind
from testbed.config.experiment import Experiment
from testbed.core.law import Concern
from testbed.metrics.formation import has_formation
from testbed.metrics.run_metrics import HOLD_S, ROUNDING_S

OF_A_RESTING_GOAL = ("settle_s", "hold_rms_m")
OF_AN_OWN_GOAL = ("final_error_m", *OF_A_RESTING_GOAL)  # laws of formations ignore goals' places


def without_number(experiment: Experiment, name: str) -> tuple[str, ...]:
    """Metrics and criteria without a number for this vehicle: its goal moves, or it has none."""
    if has_formation(experiment.controller):
        return OF_AN_OWN_GOAL
    return () if experiment.vehicles[name].path is None else OF_A_RESTING_GOAL


def never_measured(experiment: Experiment) -> list[Concern]:
    """A warning for each such criterion."""
    texts = [*_of_goals(experiment), *_of_formations(experiment)]
    return [Concern("never-measured", f"{text}: it is never met") for text in texts]


def _of_goals(experiment: Experiment) -> list[str]:
    asked, end, texts = experiment.criteria, experiment.end_s, []
    for key in OF_AN_OWN_GOAL:
        if getattr(asked, key) is None:
            continue
        vehicles = [name for name in experiment.vehicles if key in without_number(experiment, name)]
        if vehicles and has_formation(experiment.controller):
            texts.append(f"criteria.{key} is about a vehicle's own goal, and this law has none")
        elif vehicles:
            texts.append(
                f"criteria.{key} is about a goal that rests, and that of {vehicles[0]} has a path"
            )
        elif key == "hold_rms_m" and end < HOLD_S - ROUNDING_S:
            texts.append(
                f"criteria.hold_rms_m looks at the last {HOLD_S:g} s of a run, and this one ends"
                f" after {end:g} s"
            )
    return texts


def _of_formations(experiment: Experiment) -> list[str]:
    asked = experiment.criteria.formation
    if asked is None:
        return []
    if not has_formation(experiment.controller):
        return ["criteria.formation is about a formation, and this law has none"]
    if len(experiment.vehicles) < 2:
        return ["criteria.formation is about two vehicles or more, and there is one"]
    if asked.longest_edge_m is not None and formation_kind(experiment.controller) == "curves":
        return ["criteria.formation.longest_edge_m is about a graph, and this law forms curves"]
    return []
