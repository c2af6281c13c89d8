"""The chain as a whole: its memory is one array, and numba changes no bit."""

import os
import subprocess
import sys
from hashlib import sha256

import numpy as np
import pytest

from stages import agent_of
from testbed.config import find, load
from testbed.config.shipped import shipped_faults
from testbed.core.types import Demand, Health, Inputs, PoseSample
from testbed.flight.record import OUTPUTS, packing, places_in, record
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

PERIOD = 0.1  # [s]


def inputs(k):
    """A tick of a vehicle that moves and is pushed; no camera says the very same twice."""
    t = k * PERIOD
    seen = [PoseSample(t - 0.02 - 0.01 * i, 0.01 * t + 1e-4 * np.sin(9 * t + i), 0.0, 0.0)
            for i in reversed(range(10))]  # fmt: skip
    push = Demand(t, 0.2 * np.sin(t), 0.1, 0.0, 0.0, 0.0, t + 0.5)
    return Inputs(t, True, tuple(seen), push, {}, Health(t, 5e5, 2e7))


def test_a_copy_of_the_memory_is_the_whole_vehicle(vehicle, table):
    one, other = (agent_of(vehicle, table, shipped_faults()) for _ in range(2))
    for k in range(30):
        one.step(inputs(k))
    other.everything[:] = one.everything
    for k in range(30, 60):
        assert one.step(inputs(k)) == other.step(inputs(k))
    assert one.everything.tobytes() == other.everything.tobytes()


def test_every_part_of_the_memory_is_a_view_of_the_one_array(vehicle, table):
    agent = agent_of(vehicle, table, shipped_faults())

    def arrays(part):
        return [part] if isinstance(part, np.ndarray) else [a for p in part for a in arrays(p)]

    views = arrays(agent.memory)
    assert all(np.shares_memory(view, agent.everything) for view in views)
    assert sum(view.nbytes for view in views) == agent.everything.nbytes


def test_a_field_that_numpy_would_hide_is_refused():
    with pytest.raises(ValueError, match=r"found \{'size'\}"):
        record(size=float)


FLOWN = """
import sys
sys.path[:0] = {path!r}
from flight.test_chain import flown
print(flown({name!r}, {inject!r}))
"""


class Outputs(NullObserver):
    """Keeps every output."""

    def __init__(self):
        self.kept = []

    def vehicle(self, name, tick):
        self.kept.append(tick.outputs)


def flown(name, inject):
    """A digest of a short flight: the true states, and all outputs."""
    rig, outputs = make_twin(load(find(name), ["duration_s=1.0", f"inject=[{inject}]"])), Outputs()
    rig.fly(outputs)
    return sha256(rig.track().states.tobytes() + repr(outputs.kept).encode()).hexdigest()


@pytest.mark.parametrize(
    ("name", "inject"),
    [
        ("zhang2023_table", ""),
        ("zhang2023_table_wrench", "{kind='drop_mocap', vehicle='sat2', at_s=0.2, for_s=0.3}"),
    ],
)
def test_numba_changes_no_bit(name, inject):
    script = FLOWN.format(path=sys.path, name=name, inject=inject)
    plain = subprocess.run(
        [sys.executable, "-c", script], env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert plain.stdout.strip() == flown(name, inject)


def test_places_of_fields_are_those_of_their_packed_numbers():
    row = np.zeros(1, OUTPUTS)
    row["fault"], row["gate_fault"] = 7, 5
    numbers = packing(OUTPUTS).unpack(row.tobytes())
    assert [numbers[k] for k in places_in(OUTPUTS, "fault", "gate_fault")] == [7, 5]
