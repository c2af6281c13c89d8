"""The arming checks of a twin: computed here, while a lab's vehicles report them."""

from sim_twin.twin import Twin
from testbed.config import Experiment
from testbed.core.types import Accel, Pose, PoseSample, State, Twist
from testbed.flight.arming import Check, Readiness, arming_checks
from testbed.rig.chain import expected_of


def twin_checks(experiment: Experiment, twin: Twin) -> list[Check]:
    """Checks of all vehicles at time 0; the link is taken as good.

    The cameras show the truth, apart from faults that are injected from the start.
    """
    still = Accel(0.0, 0.0, 0.0)
    states: dict[str, State] = {}
    for name, row in zip(twin.names, twin.plant.x.tolist(), strict=True):
        seen = [PoseSample(0.0, *row[:3])]
        for one in seen if twin.injector is None else twin.injector.poses(name, seen):
            pose = Pose(one.x, one.y, one.theta)
            states[name] = State(0.0, pose, Twist(*row[3:]), still, -one.captured_at, 0)
    found: list[Check] = []
    for name in twin.names:
        others = {other: one for other, one in states.items() if other != name}
        ready = Readiness(
            0.0, states.get(name), experiment.table.mocap.rate_hz, twin.health(name),
            twin.vitals(name), 0.0, True, others,
        )  # fmt: skip
        found += arming_checks(ready, expected_of(experiment, name), experiment.arming)
    if experiment.table.lab.mocap.reference:
        moved = twin.lab_fault()
        found.append(Check("frame", "", "" if moved is None else moved.text))
    return found
