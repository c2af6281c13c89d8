"""One-line text about a flight that ended by a fault: seed, fault, vehicle, time."""

import re


def mishap(seed: int | None, fault: str, t: float | None) -> str:
    """Such as "seed 7: valve_stuck_closed of sat1 at 12.3 s: jet 4 gives no thrust".

    Args:
        seed: of the flight, if it is known.
        fault: text that ended the flight, "sat1: valve_stuck_closed: jet 4 gives no thrust".
        t: when it was found [s], if it is known.
    """
    lines = fault.strip().splitlines() or ["fault"]
    start = f"seed {seed}: " if seed is not None else ""
    when = f" at {t:.1f} s" if t is not None else ""
    row = re.fullmatch(r"([\w-]+): ([a-z_]+)(: .*)?", lines[-1])
    if row is None:
        return f"{start}{lines[-1]}{when}"
    return f"{start}{row[2]} of {row[1]}{when}{row[3] or ''}"
