"""The first stage of the chain whose output differs, from a tick as logged and as replayed.

Stages are looked at in the order of `flight/chain.py`: the first one whose output differs is where
the difference began, because all before it gave the same.
"""

import math
from typing import Any

from testbed.core.codes import Response

Tree = dict[str, Any]

CHAIN = (  # the outputs that a stage is the first to decide
    ("estimator", ("state",)),
    ("guidance", ("message",)),
    ("tracker", ("active_setpoint",)),
    ("safety filter", ("filtered",)),
    ("monitor", ("faults", "response")),
    ("gate", ("inhibit_reason",)),
)
ROUNDING = 1e-9  # [N]
DUTIES = "allocation or modulation"  # duties are not in the log: they are told apart by times only


def stage_of(then: Tree, now: Tree, *, on_host: bool, law_on_board: bool) -> tuple[str, str]:
    """The stage at which two outputs part, and its field; ("", "") if they are equal."""
    parted = [key for key in {**then, **now} if repr(then.get(key)) != repr(now.get(key))]
    if not parted:
        return "", ""
    if on_host:
        return "guidance", parted[0]
    for stage, keys in CHAIN:
        for key in keys:
            if key == "filtered" and key in parted and not _same_demand(then, now):
                return "tracker", "commanded_wrench"
            if key in parted:
                onboard = law_on_board and stage == "tracker"
                return "guidance" if onboard else stage, key
    return _of_the_wrench(then, now, parted)


def _same_demand(then: Tree, now: Tree) -> bool:
    """Whether the filter was given the same force; True after a response, which replaces it."""
    if max(then.get("response", 0), now.get("response", 0)) > Response.WARN:
        return True
    (x, y), (other_x, other_y) = _demanded(then), _demanded(now)
    return math.hypot(x - other_x, y - other_y) < ROUNDING


def _demanded(out: Tree) -> tuple[float, float]:
    """Force in W before the safety filter [N]."""
    force, state, command = out["commanded_wrench"], out["state"], out["command"]
    period = command["valid_until"] - command["issued_at"]
    theta = state["pose"]["theta"] + 0.5 * period * state["twist"]["omega"]
    change = out.get("filtered") or {"dfx_w": 0.0, "dfy_w": 0.0}
    c, s = math.cos(theta), math.sin(theta)
    x, y = c * force["fx"] - s * force["fy"], s * force["fx"] + c * force["fy"]
    return x - change["dfx_w"], y - change["dfy_w"]


def _of_the_wrench(then: Tree, now: Tree, parted: list[str]) -> tuple[str, str]:
    """The stage, if estimate, setpoint, filter, faults and gate agree."""
    if "fault" in parted:
        fault = now.get("fault") or then.get("fault") or {}
        return ("monitor" if fault.get("detector") else "gate"), "fault"
    if "air_off" in parted:
        return "gate", "air_off"
    if "commanded_wrench" in parted:
        brakes = now.get("response", 0) > Response.WARN
        return ("braking" if brakes else "tracker"), "commanded_wrench"
    if "command" in parted:
        before, after = then["command"], now["command"]
        if before["on_us"] == after["on_us"] and before["offset_us"] != after["offset_us"]:
            return "modulation", "command"
        return DUTIES, "command"
    return DUTIES, parted[0]
