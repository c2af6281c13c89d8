"""Finds the law that ended or blocks its vehicle's process on the bench."""

import signal
from collections.abc import Iterable

from testbed.core.codes import FaultId, FaultReport
from testbed.realtime.heartbeat import in_file
from testbed.realtime.processes import ProcessGroup


def blamed(
    children: ProcessGroup, names: Iterable[str], fault: FaultReport | None
) -> FaultReport | None:
    """The fault, with the name of the law that ended or blocks its vehicle's process.

    Args:
        children: the vehicles' processes; one that its law blocks is killed.
        names: vehicles that have not reported their end.
        fault: with which the flight ended.
    """
    for name in names:
        heartbeat = in_file(children.folder / f"{name}.heartbeat")
        if heartbeat.inside is None:
            continue
        code = children.ended(name)
        if code is None:
            children.kill(name)  # it cannot end by itself
            how = "did not return"
        elif code < 0:
            how = f"ended its process by {signal.Signals(-code).name}"
        else:
            how = f"ended its process with exit code {code}"
        text = f"law of {name} ({heartbeat.law}) {how}"
        return FaultReport(FaultId.LAW_STUCK, text, notes=(fault.words,) if fault else ())
    return fault
