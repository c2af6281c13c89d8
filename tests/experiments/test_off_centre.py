"""Vehicles whose centre of mass is far from the origin, as their file says, fly like others.

Both were stopped, for a false mass and a false leak, while the flight chain took the origin for
the centre of mass. The second is flight 59 of `benchmarks/healthy.py --centre 100 --seed 9`.
"""

import pytest

from testbed.config import find, load
from testbed.flight.hypotheses import CAUSES
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes

FLIGHTS = {
    "moves and turns": "vehicles.*.model.com=[0.1,0.05] duration_s=60",
    "weak jets": """
        vehicles.*.model.com=[-0.0766112,-0.0245141] vehicles.sat1.start=[-0.5,-0.5,0.0]
        vehicles.sat1.goal=[0.5,0.5,1.0] vehicles.*.model.valve.open_delay_s=0.0186358
        vehicles.*.model.valve.close_delay_s=0.0170151 vehicles.*.model.valve.min_on_s=0.011614
        vehicles.*.model.jets.*.thrust=0.177298 vehicles.*.model.mass=16.9918
        vehicles.*.model.inertia=0.271868 vehicles.*.model.tolerance.thrust=0.0462654
        table.mocap.rate_hz=232.797 table.mocap.noise=0.000613062 table.mocap.noise_deg=0.0919593
        table.mocap.dropout_s=0.06 table.mocap.dropout_rate=1.74779 table.link.loss=0.31932
        table.link.burst_loss=0.5 table.tilt.uniform=[-0.00112173,-0.000689794] duration_s=30
        seed=59""",
}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_centre_of_mass_off_the_origin_is_no_fault(flight):
    experiment = load(find("hold"), FLIGHTS[flight].split())
    rig, notes = make_twin(experiment), Notes()
    ending = rig.fly(notes)
    assert ending.fault is None
    causes = {detector.words for detector in CAUSES}
    named = {row for _, _, row in notes.rows}
    assert not [row for row in named if experiment.faults[row].detector in causes]
    assert not any(jet.words for jet in rig.jets("sat1"))
