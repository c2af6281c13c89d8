"""Other gains in flight for laws on board: the host's order, and the vehicle's answer."""

from collections.abc import Callable
from contextlib import suppress

from testbed.config import Experiment
from testbed.config.tunable import retuned, tunables
from testbed.net.commands import Accepted, Refused, Retune
from testbed.net.links import Party
from testbed.net.session import NetworkError
from testbed.rig.forked import ForkedAgent
from testbed.rig.wired.preflight import order


class RemoteLaw:
    """The law on board of a vehicle, as the host sees it; see `live.Changes`."""

    def __init__(self, party: Party, name: str) -> None:
        self._party, self._name = party, name

    def change(self, at_s: float, before: Experiment, after: Experiment) -> None:
        """Order the vehicle to fly with the gains of `after` from the tick at `at_s` on.

        Raises:
            NetworkError: it refuses, or does not answer.
        """
        old = {one.name: one.value for one in tunables(before.controller)}
        new = {one.name: one.value for one in tunables(after.controller)}
        self._order(at_s, {name: value for name, value in new.items() if old.get(name) != value})

    def withdraw(self, at_s: float) -> None:
        """Take the change for `at_s` back; a vehicle that does not answer is not waited for."""
        with suppress(NetworkError):
            self._order(at_s, {})

    def _order(self, at_s: float, values: dict[str, float]) -> None:
        party = self._party
        what = Retune(party.run, at_s, values)
        match order(party.session, party.keys, self._name, what):
            case Accepted():
                return
            case Refused(reason):
                raise NetworkError(f"{self._name}: {reason}")
        raise NetworkError(f"{self._name} has answered another order")


class OnboardGains:
    """The gains of a law in its vehicle's process.

    Args:
        experiment: as it was started.
        agent: flies it.
        session: number of the flight; others may not change it.
        now: time of the run [s].
    """

    def __init__(
        self, experiment: Experiment, agent: ForkedAgent, session: int, now: Callable[[], float]
    ) -> None:
        self._agent, self._session, self._now = agent, session, now
        self._period = experiment.flight.jet_period_s
        self._stages = [(0.0, experiment)]  # what flies from when on

    def obey(self, order: Retune) -> str:
        """Change the gains; why not, or empty."""
        if order.session != self._session:
            return "the order is of another session"
        if not order.at_s > self._now() + self._period:  # also if it is not a number
            return f"too late for a change at {order.at_s:.1f} s"
        if not order.values:
            self._agent.withdraw(order.at_s)
            self._stages = [one for one in self._stages if one[0] != order.at_s]
            return ""
        before = self._stages[-1][1]
        try:
            after = retuned(before, order.values)
            self._agent.change(order.at_s, before, after)
        except Exception as error:  # a user's law may raise anything
            return str(error)
        self._stages.append((order.at_s, after))
        return ""
