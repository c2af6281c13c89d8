"""Validates an experiment for firmware in the loop."""

from collections.abc import Iterator

from firmware_interface.limits import LimitsError, limits_of
from testbed.config.error import Violation
from testbed.config.experiment import Experiment


def bad_board(experiment: Experiment) -> Iterator[Violation]:
    """Errors for the firmware of the board; the model has no limits."""
    if experiment.board == "model":
        return
    period = experiment.flight.jet_period_s
    for name, setup in experiment.vehicles.items():
        try:
            limits = limits_of(setup.model)
        except LimitsError as error:
            expected = 'a vehicle that the firmware can drive, or `board = "model"`'
            yield Violation(("vehicles", name, "model"), expected, error.found or str(error))
            continue
        longest = min(limits.max_ttl_us, limits.max_on_us) * 1e-6
        if period > longest:
            expected = f"at most {longest:g} s, the longest plan of the firmware"
            yield Violation(("flight", "jet_period_s"), expected, f"{period:g} s")
