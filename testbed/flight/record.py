"""The tick's record: a vehicle's inputs, its estimate and its outputs in one tick.

Fields are numbers of eight bytes, so that a record is an array and a place in memory at once:
`row.state.x` in compiled code and in Python. SI units; frames as in core/types.py.
"""

from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.codes import Detector
from testbed.core.records.kinds import SetpointKind

Array = NDArray[np.float64]
Kind = type | np.dtype[Any] | tuple[int, ...]
NUMBER = 8  # [bytes]


def record(**fields: Kind) -> np.dtype[Any]:
    """A record's layout; a field is a number, another record, or an array of floats.

    In Python, numpy's own attributes hide fields of the same name: `size` would be 1.
    """
    if hidden := fields.keys() & set(dir(np.record)):
        raise ValueError(f"expected names that numpy does not use itself, found {hidden}")
    kinds = {int: np.dtype(np.int64), float: np.dtype(np.float64)}
    layout = [
        (name, np.float64, kind) if isinstance(kind, tuple) else (name, kinds.get(kind, kind))  # type: ignore[arg-type]
        for name, kind in fields.items()
    ]
    return np.dtype((np.record, layout))


STATE = record(  # the estimate for the time at which the next pulses take effect
    known=int,  # 0: no pose yet
    t=float,  # [s]
    x=float, y=float, theta=float,  # [m, m, rad]
    vx=float, vy=float, omega=float,  # [m/s, m/s, rad/s]
    ax=float, ay=float, alpha=float,  # bias: not explained by the jets [m/s^2, rad/s^2]
    pose_age=float,  # [s]
    rejected=int,  # see estimator.py
)  # fmt: skip

REFERENCE = record(  # desired motion at `t`, and the acceleration during the jet period
    t=float,  # [s]
    x=float, y=float, theta=float,  # [m, m, rad]
    vx=float, vy=float, omega=float,  # [m/s, m/s, rad/s]
    ax=float, ay=float, alpha=float,  # [m/s^2, rad/s^2]
)  # fmt: skip

NO_SETPOINT, TRAJECTORY, DEMAND = map(int, SetpointKind)
SETPOINT = record(
    kind=int,  # one of the three above
    t=float,  # from then on it is meant to be flown [s]
    valid_until=float,  # [s]
    # of a DEMAND: mean force in W for the coming period, and the heading to hold
    fx=float, fy=float,  # [N]
    theta=float, omega=float, alpha=float,  # [rad, rad/s, rad/s^2]
)  # fmt: skip

WRENCH = record(fx=float, fy=float, tau=float)  # in B [N, N, N m]

INPUTS = record(  # of a tick: see Health and Vitals in core/types.py
    t=float,  # now [s]
    effect_at=float,  # when the next pulses take effect [s]
    armed=int,
    ended=int,  # 1: the flight is over
    supply_pressure=float, tank_pressure=float, battery=float, silent_s=float,  # [Pa, Pa, V, s]
    session_ok=int, operator_age=float, clock_offset=float, late_s=float,  # [-, s, s, s]
    disk_free=float, same_config=int, foreign=float,  # [bytes, -, messages]
    law_failed=int, fleet_failed=int,  # 1: the law raised, another vehicle has a fault
    setpoint=SETPOINT,
)  # fmt: skip

OUTPUTS = record(  # of a tick
    seq=int,  # of the plan
    stopping=int,  # 1: the setpoint has expired, `active` is a stop
    active=REFERENCE,  # flown by the tracker
    commanded=WRENCH,  # by tracker or law, after safety: mean over the period
    realised=WRENCH,  # mean of the jets by the models of valves, droop and bad jets
    response=int,  # codes.Response
    fault=int,  # row of the fault table that is latched and decides; -1: none
    holding=int,  # number of rows that hold now
    other=int,  # the neighbour whose pose the cameras gave; -1: none
    oldest=int,  # the neighbour silent for longest; -1: none
    leak=float,  # sigmas of a jet that may leak
    hazard=int,  # avoided by the safety filter, see barrier.guarded; -1: demand not changed
    dfx=float, dfy=float,  # change of the demanded force in W [N]
    braking=int,  # 1: by the fault table
    inhibit=int,  # codes.InhibitReason; 0: the valves may open
    gate_fault=int,  # the same, latched by the gate
    air_off=int,  # 1: turn the bearing air off for good
)  # fmt: skip

ROW = record(
    inputs=INPUTS,
    state=STATE,
    outputs=OUTPUTS,
    numbers=(len(Detector),),  # of the detectors, in the order of codes.Detector
)


def packing(*kinds: np.dtype[Any]) -> Struct:
    """Packs numbers into records, and takes them out: many times faster than numpy."""
    return Struct("".join(map(_letters, kinds)))


def places_in(kind: np.dtype[Any], *names: str) -> tuple[int, ...]:
    """Places of these fields' first numbers among the numbers of a record."""
    fields: Any = kind.fields
    return tuple(fields[name][1] // NUMBER for name in names)


def _letters(kind: np.dtype[Any]) -> str:
    if kind.names:
        return "".join(_letters(kind[name]) for name in kind.names)
    return "q" if kind.kind == "i" else "d"
