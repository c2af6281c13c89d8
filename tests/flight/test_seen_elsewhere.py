"""After a step of the poses, which no jet explains, no jet is named unless one is at fault."""

import pytest

from testbed.config import find, load
from testbed.core.codes import Response
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes

METRE = ("vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]")


def flown(name, *faults, seed):
    """Rows of the fault table, worst response, and words of a flight with injected faults."""
    inject = ", ".join(f'{{vehicle="sat1",{one}}}' for one in faults)
    overrides = METRE if name == "hold" else ()
    rig = make_twin(
        load(find(name), [f"inject=[{inject}]", *overrides, "duration_s=12", f"seed={seed}"])
    )
    notes = Notes()
    rig.come_to_rest(rig.fly(notes), notes)
    rows = {row for _, _, row in notes.rows}
    words = " ".join(fault.words for _, _, fault in notes.faults)
    return rows, max(response for _, _, response in notes.responses), words


@pytest.mark.parametrize(
    ("name", "seed", "fault", "row"),
    [
        ("hold", 1024, 'kind="turn_frame",value=1.18727937,at_s=4.3864', "frame_shifted"),
        ("hold", 1004, 'kind="turn_frame",value=1.76998017,at_s=4.6829', "frame_shifted"),
        (
            "zhang2023_table",
            1007,
            'kind="turn_frame",value=1.35427236,at_s=8.0631',
            "frame_shifted",
        ),
        ("hold", 1000, 'kind="delay_mocap",value=0.22378326,at_s=8.6706', "poses_step_back"),
    ],
)
def test_a_step_of_the_poses_is_no_push_of_a_jet(name, seed, fault, row):
    rows, response, _ = flown(name, fault, seed=seed)
    assert row in rows
    assert not {one for one in rows if one.startswith(("valve", "jet"))}
    assert response == Response.BRAKE


@pytest.mark.parametrize("jet", [1, 3, 8])
def test_a_valve_that_sticks_open_while_the_vehicle_brakes_for_a_step_is_found(jet):
    turned, open_ = 'kind="turn_frame",value=1.2,at_s=4.0', f'kind="stick_open",jet={jet},at_s=4.2'
    rows, response, words = flown("hold", turned, open_, seed=3)
    assert {"frame_shifted", "valve_stuck_open"} <= rows
    assert response == Response.LAND
    assert f"jet {jet} " in words
