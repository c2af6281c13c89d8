"""`testbed commission`: verdicts, report, measured file, refusals; and the record for arming."""

import json

import pytest
from msgspec import to_builtins
from msgspec.structs import replace

from testbed.config import find, load
from testbed.rig.commissioning import not_commissioned, record_of, save


def test_a_rehearsal_on_the_twin_leaves_a_report_and_a_vehicle_file(testbed, here):
    result = testbed("commission", "hold", "--yes", "--out", "found")
    assert result.exit_code == 0, result.output
    for step in ("board", "pressure", "cameras", "frame", "clicks", "float", "jets"):
        assert f"sat1     {step}" in result.output
    tree = json.loads((here / "found" / "commission.json").read_text())
    assert {v["step"] for v in tree["verdicts"]} >= {"frame", "jets"}
    again = testbed("check", "hold", "vehicles.sat1.model=found/sat1.toml")
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--rig", "table", "--yes"], "a person at a terminal"),
        (["--rig", "table"], "a person at a terminal"),
        (["--vehicle", "sat7"], "one of: sat1"),
    ],
)
def test_what_is_refused(testbed, here, words, said):
    result = testbed("commission", "hold", *words)
    assert result.exit_code == 2
    assert said in result.output
    assert not list(here.iterdir())


def test_more_jets_than_a_board_drives_are_refused(testbed, here):
    experiment = load(find("hold"))
    jets = [to_builtins(jet) for jet in experiment.vehicles["sat1"].model.jets]
    words = ", ".join(
        f"{{position = {list(jet['position'])}, push = {list(jet['push'])}, thrust = 0.3}}"
        for jet in [*jets, jets[0]]
    )
    result = testbed("commission", "hold", f"vehicles.sat1.model.jets=[{words}]", "--yes")
    assert result.exit_code == 2, result.output
    assert "expected  1 to 8 jets" in result.stderr
    assert not list(here.iterdir())


def test_a_record_holds_until_vehicle_table_or_firmware_change(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    experiment, board = load(find("hold")), "firmware 12345678 at /dev/ttyACM0"
    assert "no record" in not_commissioned(experiment, "sat1", board)
    path = save(experiment, "sat1", record_of(experiment, "sat1", board, "2026-01-01", "found"))
    assert not_commissioned(experiment, "sat1", board) == ""
    assert not_commissioned(experiment, "sat1", "firmware 12345678 at /dev/ttyACM1") == ""
    assert "firmware 87654321" in not_commissioned(experiment, "sat1", "firmware 87654321 at x")
    heavy = load(find("hold"), ["vehicles.sat1.model.mass=13.0"])
    assert "vehicle file has changed" in not_commissioned(heavy, "sat1", board)
    steep = load(find("hold"), ["table.tilt.uniform=[0.01,0.0]"])
    assert "table file has changed" in not_commissioned(steep, "sat1", board)
    other = replace(experiment, vehicles={"sat2": experiment.vehicles["sat1"]})
    assert "no record" in not_commissioned(other, "sat2", board)
    path.write_text("{")
    assert "again" in not_commissioned(experiment, "sat1", board)
