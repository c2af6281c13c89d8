"""Reasons of the gate, with their values."""

import numpy as np
from numpy.typing import NDArray

from testbed.core.codes import FaultReport, InhibitReason, Refusal

Array = NDArray[np.float64]

REASONS = {one.value: one for one in InhibitReason}


def refusal_of(code: int, gate_fault: int, values: Array) -> Refusal:
    """The reason with the values of its words."""
    reason, shown = REASONS[code], ()
    if code == gate_fault:
        shown = tuple(values[: reason.words.count("{")].tolist())
    return Refusal(reason, shown)


def reported(refusal: Refusal) -> FaultReport:
    """The report of a reason that the gate has latched."""
    return FaultReport(refusal.code.name.lower(), refusal.words)
