"""Warns about criteria that a run cannot meet, because it never measures their number."""

from testbed.config.experiment import Experiment
from testbed.core.law import Concern
from testbed.metrics.formation import has_formation
from testbed.metrics.run_metrics import HOLD_S, ROUNDING_S


def never_measured(experiment: Experiment) -> list[Concern]:
    """A warning for each such criterion."""
    asked, end, texts = experiment.criteria, experiment.end_s, []
    if asked.hold_rms_m is not None and end < HOLD_S - ROUNDING_S:
        texts.append(
            f"criteria.hold_rms_m looks at the last {HOLD_S:g} s of a run, and this one ends after"
            f" {end:g} s"
        )
    if asked.formation is not None and not has_formation(experiment.controller):
        texts.append("criteria.formation is about a formation, and this law has none")
    return [Concern("never-measured", f"{text}: it is never met") for text in texts]
