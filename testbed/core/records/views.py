"""Views of rows for compiled code: one array per part, with types that fit every fleet.

`fixed[k]` is the fixed part of row `k`, `samples[k, :samples_count[k]]` its samples.
"""

from typing import Any, NamedTuple

from numpy.typing import NDArray

Records = NDArray[Any]  # (rows,) or (rows, capacity) records


class TickRows(NamedTuple):
    """Rows of `Tick`."""

    fixed: Records  # .inputs, .outputs
    samples: Records
    samples_count: Records
    neighbours: Records
    neighbours_count: Records
    references: Records
    references_count: Records
    pulses: Records
    pulses_count: Records
    heard: Records
    heard_count: Records
    heard_values: Records
    heard_values_count: Records
    message: Records
    message_count: Records


class HostTickRows(NamedTuple):
    """Rows of `HostTick`."""

    fixed: Records  # .inputs, .outputs
    neighbours: Records
    neighbours_count: Records
    references: Records
    references_count: Records
    heard: Records
    heard_count: Records
    heard_values: Records
    heard_values_count: Records
    message: Records
    message_count: Records


class TruthRows(NamedTuple):
    """Rows of `Truth`."""

    fixed: Records  # .t
    vehicles: Records
    vehicles_count: Records
