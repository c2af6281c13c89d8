"""Validates injected faults: vehicles, jets and events must exist."""

from collections.abc import Iterator

from testbed.config.error import Violation, show
from testbed.config.experiment import Experiment
from testbed.core.fault_injection import WITH_OTHER

SHARES = ("leak_valve", "weak_jet", "half_open")
POSITIVE = (
    "slow_mocap", "delay_mocap", "scale_frame", "pad_drag", "regulator", "thrust", "mass", "flood",
)  # fmt: skip


def bad_injections(experiment: Experiment) -> Iterator[Violation]:
    """Errors in `[[inject]]`."""
    names = ", ".join(experiment.vehicles)
    for k, what in enumerate(experiment.inject):
        key = ("inject", k)
        if what.vehicle not in experiment.vehicles:
            yield Violation((*key, "vehicle"), f"one of: {names}", show(what.vehicle))
            continue
        if what.kind in WITH_OTHER and (
            what.other == what.vehicle or what.other not in experiment.vehicles
        ):
            yield Violation((*key, "other"), f"another one of: {names}", show(what.other))
        if what.kind == "brown_out" and experiment.board in ("inproc", "unicorn", "qemu"):
            found = f'board = "{experiment.board}"'
            yield Violation((*key, "kind"), 'board = "model" with it', found)
        jets = len(experiment.vehicles[what.vehicle].model.jets)
        if not 1 <= what.jet <= jets:
            yield Violation((*key, "jet"), f"a jet from 1 to {jets}", show(what.jet))
        if what.kind == "swap_jets" and (
            what.size == what.jet or what.size not in range(1, jets + 1)
        ):
            expected = f"the number of the other jet, from 1 to {jets}"
            yield Violation((*key, "value"), expected, f"{what.size:g}")
        if what.kind in SHARES and not 0.0 < what.size <= 1.0:
            expected = "a share of the jet's flow, more than 0 and at most 1: 30 % is 0.3"
            yield Violation((*key, "value"), expected, f"{what.size:g}")
        if what.kind in POSITIVE and not what.size > 0.0:
            yield Violation((*key, "value"), "more than 0", f"{what.size:g}")
        if what.event == "near_obstacle" and not experiment.obstacles:
            yield Violation((*key, "event"), "an event that can happen", "no obstacle is there")
        if what.event == "near_vehicle" and len(experiment.vehicles) < 2:
            yield Violation(
                (*key, "event"), "an event that can happen", "no other vehicle is there"
            )
