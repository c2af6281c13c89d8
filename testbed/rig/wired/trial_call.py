"""Calls of the laws before a flight: whether they work, and so that their code is compiled."""

from collections.abc import Callable

from msgspec.structs import replace

from testbed.config import Experiment
from testbed.core.types import Accel, LawMessage, Pose, Setpoint, State, Twist
from testbed.flight.agent import lead_time
from testbed.flight.loop import HostNode
from testbed.rig.chain import make_barrier, make_guidance


class TrialLink:
    """A `HostLink` for a single trial call of a law; its output is dropped."""

    def __init__(self, own: State, others: dict[str, State]) -> None:
        self._own, self._others = own, others

    def own(self) -> State:
        """See `HostLink`."""
        return self._own

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        return self._others

    def publish(self, setpoint: Setpoint) -> None:
        """See `HostLink`."""

    def messages(self) -> dict[str, LawMessage]:
        """See `HostLink`."""
        return {}

    def broadcast(self, message: LawMessage) -> None:
        """See `HostLink`."""


def trial_error(
    experiment: Experiment, name: str, states: dict[str, State],
    spoilt: Callable[[], str] | None = None,
) -> str:  # fmt: skip
    """Error of a vehicle's law in a trial call with the current states; empty: no error.

    The host makes this call also for a law that will run on board. `spoilt`: see make_guidance.
    """
    now = {other: replace(state, t=0.0) for other, state in states.items()}
    link = TrialLink(now.pop(name), now)
    lead = lead_time(experiment.vehicles[name].model)
    try:
        guidance = make_guidance(experiment, name, spoilt)
    except Exception as error:  # a user's law may raise anything
        return f"{type(error).__name__}: {error}"
    node = HostNode(name, guidance, link, experiment.flight.jet_period_s, lead)
    fault = node.tick(0.0).outputs.fault
    return "" if fault is None else fault.text


def compile_host(experiment: Experiment) -> None:
    """Run what the host runs for vehicles in other processes, before they listen to it.

    The twin does not run it in this form, and a host that compiles in flight is gone for seconds.
    """
    still, no_bias = Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0)
    states = {
        name: State(0.0, Pose(*setup.start), still, no_bias, 0.0, 0)
        for name, setup in experiment.vehicles.items()
    }
    for name, state in states.items():
        spoilt = (lambda: "") if experiment.inject else None  # as in the flight
        trial_error(experiment, name, states, spoilt)  # an error is told at the start
        others = {other: one for other, one in states.items() if other != name}
        at_rest = (state.pose.x, state.pose.y, 0.0, 0.0, 0.0, 0.0)
        if (barrier := make_barrier(experiment, name)) is not None:
            barrier.filter(0.0, (0.0, 0.0), at_rest, others)
