"""The arming checks of all vehicles, collected by the host over the network."""

from collections.abc import Callable

import msgspec
import zenoh
from msgspec.structs import replace

from testbed.config import Experiment
from testbed.flight.arming import Check, arming_checks
from testbed.net.commands import Answer, Look, Order, Ready, Refused, config_id
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, ask
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.chain import expected_of
from testbed.rig.commissioning import not_commissioned
from testbed.rig.wired.trial_call import trial_error


def order(session: zenoh.Session, keys: Keys, name: str, what: Order) -> Answer:
    """A vehicle's answer to an order.

    Raises:
        NetworkError: it does not answer, or the answer cannot be decoded.
    """
    data = ask(session, keys.of(name, "order"), msgspec.msgpack.encode(what))
    try:
        answer: Answer = msgspec.msgpack.decode(data, type=Answer)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        raise NetworkError(f"{name}: the answer to an order cannot be decoded") from None
    return answer


class Preflight:
    """Asks every vehicle for its readiness and calls every law once as a trial.

    Args:
        experiment: the experiment to fly.
        session: the network.
        keys: of the lab.
        disk_free: free space on the disk of the log [bytes].
        hardware: vehicles may need a record of their commissioning.
    """

    def __init__(
        self,
        experiment: Experiment,
        session: zenoh.Session,
        keys: Keys,
        disk_free: Callable[[], float],
        *,
        hardware: bool = False,
    ) -> None:
        self._experiment, self._session, self._keys = experiment, session, keys
        self._records = hardware and experiment.arming.commissioned
        self._disk_free, self._config = disk_free, config_id(experiment)
        self._sound: set[str] = set()  # vehicles whose law passed the trial call

    def checks(self) -> list[Check]:
        """All checks, passed and failed."""
        answered: dict[str, tuple[Ready, float]] = {}
        found: list[Check] = []
        for name in self._experiment.vehicles:
            asked = monotonic_ns()
            try:
                answer = order(self._session, self._keys, name, Look())
            except NetworkError as error:
                found.append(Check("link", name, str(error)))
                continue
            match answer:
                case Ready():
                    answered[name] = answer, 1e-9 * (monotonic_ns() - asked)
                case Refused(reason):
                    found.append(Check("board", name, reason))
        states = {n: one.readiness.state for n, (one, _) in answered.items()}
        known = {n: s for n, s in states.items() if s is not None}
        for name, (one, trip) in answered.items():
            law_error = ""
            if name not in self._sound and len(known) == len(self._experiment.vehicles):
                law_error = trial_error(self._experiment, name, known)
                if not law_error:
                    self._sound.add(name)
            others = {n: s for n, s in states.items() if n != name and s is not None}
            vitals = replace(
                one.readiness.vitals,
                disk_free=self._disk_free(),
                same_config=one.config == self._config,
                law_error=law_error,
            )
            ready = replace(one.readiness, vitals=vitals, round_trip=trip, neighbours=others)
            expected = expected_of(self._experiment, name)
            found += arming_checks(ready, expected, self._experiment.arming)
            if self._records:
                why = not_commissioned(self._experiment, name, one.board)
                found.append(Check("commissioned", name, why, at_reset=False))
        if self._experiment.table.lab.mocap.reference:
            moved = (one.readiness.vitals.fleet for one, _ in answered.values())
            found.append(Check("frame", "", next((one.text for one in moved if one), "")))
        return found
