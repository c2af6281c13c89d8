"""Bodies of messages on the network.

A state, a setpoint or a law's message is a record as CDR: the same bytes as in the log and ROS 2.
Messages with text (leases, ticks for the log, reports) are MessagePack.
"""

from itertools import chain
from typing import Any

import msgspec

from testbed.core.records.kinds import SetpointKind
from testbed.core.rows import References, structs_of
from testbed.core.types import Demand, LawMessage, Setpoint, State, Trajectory
from testbed.logs.packing import elements, getter, made, packed, unpack

LARGEST = 1e9  # numbers beyond it are refused
NAN = float("nan")
NO_DEMAND = (NAN,) * 7
_state, _reference, _demand = getter("State"), getter("Reference"), getter("Demand")
_other = msgspec.msgpack.Encoder(enc_hook=structs_of).encode


def body_of(message: Any) -> bytes:
    """The bytes of a message."""
    match message:
        case State():
            return packed("State", _state(message))
        case Demand():
            aim = (*_demand(message), NAN, SetpointKind.DEMAND)
            return packed("Setpoint", aim, elements("Reference", ()))
        case Trajectory(ahead, until):
            aim = (*NO_DEMAND, until, SetpointKind.TRAJECTORY)
            rows = References.of(ahead).rows
            return packed("Setpoint", aim, (len(rows), rows.tobytes()))
        case LawMessage(t, values):
            return packed("LawMessage", (t,), elements("float64", ((one,) for one in values)))
    return _other(message)


def open_state(data: bytes) -> State:
    """A vehicle's state; all numbers must be finite and below 1e9.

    Raises:
        ValueError: it is no such state.
    """
    numbers = unpack("State", data).fixed
    _insist(numbers)
    return made(State, iter(numbers))


def open_setpoint(data: bytes) -> Setpoint:
    """A setpoint, with the same limit; a trajectory must not be empty.

    Raises:
        ValueError: it is no such setpoint.
    """
    row = unpack("Setpoint", data)
    *demand, until, kind = row.fixed
    ahead = row.sequences["references"]
    match kind:
        case SetpointKind.DEMAND:
            _insist(demand)
            return Demand(*demand)
        case SetpointKind.TRAJECTORY if ahead:
            _insist([until, *chain.from_iterable(ahead)])
            return Trajectory(References.from_numbers(ahead), until)
    raise ValueError(
        f"expected a demand or a trajectory, found kind {kind}, {len(ahead)} references"
    )


def open_message(data: bytes) -> LawMessage:
    """A law's message, with the same limit.

    Raises:
        ValueError: it is no such message.
    """
    row = unpack("LawMessage", data)
    values = tuple(chain.from_iterable(row.sequences["values"]))
    t = row.fixed[0]
    _insist([t, *values])
    return LawMessage(t, values)


def _insist(numbers: Any) -> None:
    for one in numbers:
        if not abs(one) < LARGEST:  # also nan
            raise ValueError(f"a number of {one}")
