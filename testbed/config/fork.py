"""Validates `[[forks]]`: changes in flight."""

from collections.abc import Callable, Iterator

from testbed.config.error import Mistake
from testbed.config.experiment import Experiment


def bad_forks(
    experiment: Experiment, mistakes: Callable[[Experiment], Iterator[Mistake]]
) -> Iterator[Mistake]:
    """Errors in `[[forks]]`; `mistakes` finds those of an experiment without forks."""
    last = 0.0
    for k, (at, stage) in enumerate(experiment.stages()):
        key = ("forks", k)
        if not last <= at < experiment.end_s:
            expected = f"a time of the flight, from {last:g} s to less than {experiment.end_s:g} s"
            yield Mistake((*key, "at_s"), expected, f"{at:g} s")
        last = at
        for part in ("jet_period_s", "gate"):
            before, after = getattr(experiment.flight, part), getattr(stage.flight, part)
            if before != after:
                expected = "the value from before the fork: it cannot change in flight"
                yield Mistake((*key, "flight", part), expected, "another value")
        for mistake in mistakes(stage):
            yield mistake._replace(key=(*key, *mistake.key))
