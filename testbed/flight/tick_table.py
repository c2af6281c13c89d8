"""The ticks of one vehicle as a table: a record for each tick, and the lists that belong to it.

The chain works on one record. A rig that flies many ticks keeps each of them as a row here. The log
and the metrics take whole columns; a tick's structs are made for those who look at one.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.rows import SETPOINT_WIDTH, PoseSamples, References, States
from testbed.flight.record import ROW

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

# most rows of a table, as many as a chunk of a fast log has at 10 Hz, and most bytes that they take
TICKS, SIZE = 250, 800_000
SAMPLES, STATES, REFERENCES = range(3)  # columns of `TickTable.counts`


class TickTable(NamedTuple):
    """Ticks of one vehicle, a row each."""

    records: NDArray[Any]  # (n,) record.ROW
    counts: Whole  # (n, 3) poses, states of others and references in use
    samples: Array  # (n, most, 4) see rows.PoseSamples
    states: Array  # (n, most, 12) the newest one of each other vehicle, see rows.States
    vehicles: Whole  # (n, most) whose they are, numbered as in the experiment
    references: Array  # (n, most, 10) of the setpoint, see rows.References
    plans: Array  # (n, 2 jets) on-times, then offsets [us]
    values: Array  # (n, 3) of the words of a latched refusal of the gate
    holds: Array  # (n, rows of the fault table) 1: it holds

    @property
    def room(self) -> tuple[int, int]:
        """Most poses and references of a tick."""
        return self.samples.shape[1], self.references.shape[1]


def make_table(
    jets: int, others: int, rows: int, room: tuple[int, int], ticks: int | None = None
) -> TickTable:
    """An empty table.

    Args:
        jets: of the vehicle.
        others: other vehicles.
        rows: of the fault table.
        room: most poses and references of a tick.
        ticks: rows; None: as many as are worth their memory.
    """
    samples, references = room
    if ticks is None:
        words = 3 + 4 * samples + 13 * others + 10 * references + 2 * jets + 3 + rows
        ticks = ticks_of(ROW.itemsize + 8 * words)
    return TickTable(
        np.zeros(ticks, ROW),
        np.zeros((ticks, 3), np.int64),
        np.empty((ticks, samples, PoseSamples.width)),
        np.empty((ticks, others, States.width)),
        np.empty((ticks, others), np.int64),
        np.empty((ticks, references, References.width)),
        np.empty((ticks, 2 * jets)),
        np.empty((ticks, 3)),
        np.empty((ticks, rows)),
    )


def ticks_of(row: int) -> int:
    """Rows of a table, of so many bytes each: many are written to the log faster than few."""
    return max(1, min(TICKS, SIZE // row))


class HostTable(NamedTuple):
    """Ticks of one vehicle's law on the host, a row each."""

    t: Array  # (n,) [s]
    counts: Whole  # (n, 2) states of others and references in use
    own: Array  # (n, 12) newest state of the vehicle, see rows.States
    states: Array  # (n, most, 12) the newest one of each other vehicle
    vehicles: Whole  # (n, most) whose they are, numbered as in the experiment
    setpoints: Array  # (n, 8) see rows.numbers_of
    references: Array  # (n, most, 10) of the setpoint, see rows.References


def make_host_table(others: int, references: int) -> HostTable:
    """An empty table; see `make_table`."""
    ticks = ticks_of(8 * (23 + 13 * others + 10 * references))
    return HostTable(
        np.empty(ticks),
        np.zeros((ticks, 2), np.int64),
        np.empty((ticks, States.width)),
        np.empty((ticks, others, States.width)),
        np.empty((ticks, others), np.int64),
        np.empty((ticks, SETPOINT_WIDTH)),
        np.empty((ticks, references, References.width)),
    )
