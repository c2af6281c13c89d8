"""One-line text about a flight that ended by a fault: seed, fault, vehicle, time."""

from msgspec.structs import replace

from testbed.core.codes import FaultReport


def fault_line(seed: int | None, fault: FaultReport, t: float | None) -> str:
    """A line such as "seed 7: valve_stuck_closed of sat1 at 12.3 s: jet 4 gives no thrust".

    Args:
        seed: of the flight, if it is known.
        fault: that ended the flight.
        t: when it was found [s], if it is known.
    """
    start = f"seed {seed}: " if seed is not None else ""
    when = f" at {t:.1f} s" if t is not None else ""
    if not fault.detector:
        return f"{start}{_line(fault)}{when}"
    text = _line(replace(fault, vehicle="", detector="", text=fault.after_id))
    return f"{start}{fault.id} of {fault.vehicle}{when}: {text}"


def _line(fault: FaultReport) -> str:
    return " ".join(fault.words.split())
