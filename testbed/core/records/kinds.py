"""Codes of messages that are not in `core/codes.py`."""

from enum import IntEnum


class SetpointKind(IntEnum):
    """Kind of a setpoint."""

    NONE = 0
    TRAJECTORY = 1
    DEMAND = 2


class Active(IntEnum):
    """Input of the tracker."""

    NONE = 0
    REFERENCE = 1
    DEMAND = 2


class FaultCode(IntEnum):
    """Codes of faults; a smaller one is the number of a row of the fault table plus one."""

    NONE = 0
    GATE = 1000  # plus the code in `inhibit`
    OTHER = 2000  # its text is an event


class EventKind(IntEnum):
    """What an event's text is about."""

    FAULT = 1
    LAW_ERROR = 2
    FLEET = 3
    LAW_FAULT = 4
    CAMERAS = 5
    PHASE = 6
    STICK = 7
