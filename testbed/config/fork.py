"""Validates `[[forks]]`: changes in flight."""

from collections.abc import Callable, Iterator

from testbed.config.error import Violation
from testbed.config.experiment import Experiment


def bad_forks(
    experiment: Experiment, violations: Callable[[Experiment], Iterator[Violation]]
) -> Iterator[Violation]:
    """Errors in `[[forks]]`; `violations` finds those of an experiment without forks."""
    last = 0.0
    for k, (at, stage) in enumerate(experiment.stages()):
        key = ("forks", k)
        if not last <= at < experiment.end_s:
            expected = f"a time of the flight, from {last:g} s to less than {experiment.end_s:g} s"
            yield Violation((*key, "at_s"), expected, f"{at:g} s")
        last = at
        for part in ("jet_period_s", "gate"):
            before, after = getattr(experiment.flight, part), getattr(stage.flight, part)
            if before != after:
                expected = "the value from before the fork: it cannot change in flight"
                yield Violation((*key, "flight", part), expected, "another value")
        for violation in violations(stage):
            yield violation._replace(key=(*key, *violation.key))
