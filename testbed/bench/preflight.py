"""The arming checks of all vehicles, as the host collects them over the network."""

from collections.abc import Callable

import msgspec
import zenoh
from msgspec.structs import replace

from testbed.config import Experiment
from testbed.flight.arming import Check, arming_checks
from testbed.ops.network.keys import Keys
from testbed.ops.network.orders import Answer, Look, Order, Ready, Refused, config_id
from testbed.ops.network.session import NetworkError, ask
from testbed.ops.ticking import monotonic_ns
from testbed.rig.chain import expected_of


def order(session: zenoh.Session, keys: Keys, name: str, what: Order) -> Answer:
    """A vehicle's answer to an order.

    Raises:
        NetworkError: it does not answer, or not as one does.
    """
    data = ask(session, keys.of(name, "order"), msgspec.msgpack.encode(what))
    try:
        answer: Answer = msgspec.msgpack.decode(data, type=Answer)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        raise NetworkError(f"{name} answers an order with what is no answer") from None
    return answer


class Preflight:
    """Asks every vehicle how it is.

    Args:
        experiment: that is to be flown.
        session: the network.
        keys: of the lab.
        disk_free: where the log goes [bytes].
    """

    def __init__(
        self,
        experiment: Experiment,
        session: zenoh.Session,
        keys: Keys,
        disk_free: Callable[[], float],
    ) -> None:
        self._experiment, self._session, self._keys = experiment, session, keys
        self._disk_free, self._config = disk_free, config_id(experiment)

    def checks(self) -> list[Check]:
        """All of them, red and green."""
        heard: dict[str, tuple[Ready, float]] = {}
        found: list[Check] = []
        for name in self._experiment.vehicles:
            asked = monotonic_ns()
            try:
                answer = order(self._session, self._keys, name, Look())
            except NetworkError as error:
                found.append(Check(f"{name} link", str(error), at_reset=True))
                continue
            match answer:
                case Ready():
                    heard[name] = answer, 1e-9 * (monotonic_ns() - asked)
                case Refused(reason):
                    found.append(Check(f"{name} board", reason, at_reset=True))
        states = {n: one.readiness.state for n, (one, _) in heard.items()}
        for name, (one, trip) in heard.items():
            others = {n: s for n, s in states.items() if n != name and s is not None}
            vitals = replace(
                one.readiness.vitals,
                disk_free=self._disk_free(),
                same_config=one.config == self._config,
            )
            ready = replace(one.readiness, vitals=vitals, round_trip=trip, neighbours=others)
            expected = expected_of(self._experiment, name)
            found += arming_checks(ready, expected, self._experiment.arming)
        return found
