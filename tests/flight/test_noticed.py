"""What a vehicle notices during a flight that goes on: once per row, at its clearest."""

import numpy as np
import pytest

from testbed.config import find, load
from testbed.core.codes import Detector
from testbed.core.law import Concern
from testbed.core.warned import Warned, noticed
from testbed.flight.fault_warnings import FaultWarnings
from testbed.metrics.run_metrics import ReferenceLog
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.judge import measure

FAULTS = list(load(find("hold")).faults.items())
ROWS = [name for name, _ in FAULTS]


def look(warnings, t, row, number, said="a hose"):
    holds, numbers = np.zeros(len(FAULTS)), np.zeros(len(Detector))
    k = ROWS.index(row)
    holds[k], numbers[FAULTS[k][1].measures] = 1.0, number
    warnings.look(t, holds, numbers, lambda detector: said)


def test_a_row_keeps_its_first_time_and_its_clearest_words():
    warnings = FaultWarnings(FAULTS)
    look(warnings, 3.0, "pulled", 5.1, "perhaps a hose")
    look(warnings, 4.0, "pulled", 14.0, "a hose")
    look(warnings, 5.0, "pulled", 9.0, "less of it")
    look(warnings, 6.0, "supply_weak", 0.88)  # a row that holds below its bound
    look(warnings, 7.0, "supply_weak", 0.8)
    look(warnings, 8.0, "supply_weak", 0.85)
    assert warnings.found == {
        "pulled": Warned(3.0, 14.0, "a hose"),
        "supply_weak": Warned(6.0, 0.8, "supply pressure at 80% of its set value"),
    }
    assert noticed({"sat2": warnings.found, "sat3": {}})[0] == Concern(
        "pulled", "sat2: a hose (from 3.0 s)"
    )


@pytest.mark.parametrize("row", ["pose_stale", "link_late", "neighbour_late", "fleet", "pose_lost"])
def test_lost_messages_and_faults_that_end_the_flight_are_not_listed(row):
    warnings = FaultWarnings(FAULTS)
    look(warnings, 3.0, row, 1.0)
    assert warnings.found == {}


@pytest.mark.parametrize(
    ("kind", "row", "words"),
    [("hose", "pulled", "hose or tilt pulls with 0.1"),
     ("slow_mocap", "pose_rate_low", "the cameras give")],
)  # fmt: skip
def test_a_cause_in_flight_is_a_warning_of_the_result(kind, row, words):
    inject = f'inject=[{{kind="{kind}",vehicle="sat2",at_s=10.0}}]'
    (warning,) = flown("zhang2023_table", "duration_s=14", inject)
    assert warning.name == row
    assert warning.text.startswith(f"sat2: {words}")
    assert warning.text.endswith(("(from 12.0 s)", "(from 12.6 s)"))


def test_a_healthy_flight_warns_of_nothing():
    assert flown("hold", "duration_s=8") == []


def flown(name, *overrides):
    rig = make_twin(load(find(name), overrides))
    references = {one: ReferenceLog() for one in rig.experiment.vehicles}
    return measure(rig, references, rig.fly(NullObserver()), 1.0, completed=True).warnings
