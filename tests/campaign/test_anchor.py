"""Paths in campaign, tuning and benchmark files are relative to the file."""

import shutil
from pathlib import Path

import pytest
import tomli_w

from testbed.campaign.anchor import anchored
from testbed.campaign.flight import replay_command, what_changed
from testbed.campaign.sweep import load_campaign
from testbed.campaign.trial import read
from testbed.campaign.tuning import load_tuning
from testbed.config import ConfigError
from testbed.config.shipped import shipped


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with a table; the current folder has another table of the same name."""
    (tmp_path / "lab").mkdir()
    (tmp_path / "here").mkdir()
    shutil.copy(shipped("tables")["rough_4m"], tmp_path / "lab/own.toml")
    shutil.copy(shipped("tables")["marble_6m"], tmp_path / "here/own.toml")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "lab"


def written(lab, **content):
    path = lab / "file.toml"
    path.write_text(tomli_w.dumps({"name": "c", "experiment": "hold", **content}))
    return path


ROUGH, MARBLE = (4.0, 4.0), (6.0, 6.0)
AXES = {
    "values": {"key": "table", "values": ["own.toml", "marble_6m"]},
    "cases": {"name": "t", "cases": {"own": ["table=own.toml"], "other": ["table=marble_6m"]}},
}


@pytest.mark.parametrize("axis", AXES)
def test_a_table_of_the_grid_is_beside_the_file(lab, axis):
    campaign = load_campaign(written(lab, grid=[AXES[axis]]))
    sizes = [tuple(read(campaign.base, campaign.overrides(k)).table.size) for k in (0, 1)]
    assert sizes == [ROUGH, MARBLE]
    assert str(lab / "own.toml") in replay_command(campaign, lab / "c", 0)
    assert "'table=\"marble_6m\"'" in replay_command(campaign, lab / "c", 1) or axis == "cases"


def test_a_table_for_all_runs_is_beside_the_file(lab):
    campaign = load_campaign(written(lab, set=["table=own.toml"]))
    assert tuple(read(campaign.base, campaign.overrides(0)).table.size) == ROUGH
    gain = {"key": "controller.bandwidth", "low": 0.1, "high": 0.2}
    cost = {"goal_rms_m": 1.0}
    path = written(lab, set=["table=own.toml"], gain=[gain], cost=cost)
    assert tuple(read(load_tuning(path).base, ()).table.size) == ROUGH


def test_a_file_that_is_missing_is_named_by_its_whole_path(lab):
    (lab / "own.toml").unlink()
    for content in ({"set": ["table=own.toml"]}, {"grid": [AXES["cases"]]}):
        with pytest.raises(ConfigError) as caught:
            load_campaign(written(lab, **content))
        assert str(lab / "own.toml") in caught.value.where


def test_a_grid_with_other_files_is_another_campaign(lab, tmp_path):
    shutil.copytree(lab, tmp_path / "other")
    for axis, same in (
        (AXES["values"], False),
        ({"key": "controller.bandwidth", "values": [0.2]}, True),
    ):
        payloads = {
            load_campaign(written(folder, grid=[axis])).payload()
            for folder in (lab, tmp_path / "other")
        }
        assert (len(payloads) == 1) is same


EXAMPLES = Path(__file__).parents[2] / "examples"
CAR = {"model": "car.toml", "start": [0.0, 0.0, 0.0], "goal": [0.1, 0.0, 0.0]}
LAW = {"type": "python", "law": "own_law.py:Spring"}
FILES = {
    "a table": ("own.toml", {"key": "table", "values": ["own.toml", "marble_6m"]}),
    "an absolute path": ("own.toml", {"key": "table", "values": ["{}/own.toml", "marble_6m"]}),
    "in cases": ("own.toml", {"name": "t", "cases": {"own": ["table=own.toml"], "other": []}}),
    "a vehicle": ("car.toml", {"key": "vehicles.sat1.model", "values": ["car.toml"]}),
    "a vehicle in a table": ("car.toml", {"key": "vehicles.sat1", "values": [CAR]}),
    "a law": ("own_law.py", {"key": "controller", "values": [LAW]}),
}


@pytest.mark.parametrize("case", FILES)
def test_a_grid_whose_file_has_changed_is_another_campaign(lab, case):
    name, axis = FILES[case]
    shutil.copy(shipped("vehicles")["generic_8jet"], lab / "car.toml")
    shutil.copy(EXAMPLES / "own_law.py", lab)
    if "values" in axis:
        values = [v.format(lab) if isinstance(v, str) else v for v in axis["values"]]
        axis = {**axis, "values": values}
    path = written(lab, grid=[axis])
    before = load_campaign(path).payload()
    assert load_campaign(path).payload() == before
    (lab / "campaign.toml").write_bytes(path.read_bytes())
    (lab / "base.toml").write_text(load_campaign(path).base)
    with (lab / name).open("a") as file:
        file.write("# changed\n")
    changed = load_campaign(path)
    assert changed.payload() != before
    assert "a file that the grid names" in what_changed(changed, lab)


@pytest.mark.parametrize("name", ['"a\\u0000"', "loop.toml"])
def test_a_path_that_cannot_be_resolved_is_refused(lab, name):
    (lab / "loop.toml").symlink_to(lab / "loop.toml")
    with pytest.raises(ConfigError):
        load_campaign(written(lab, set=[f"table={name}"]))


@pytest.mark.parametrize(
    ("text", "placed"),
    [
        ("vehicles.*.model=lab/x.toml", 'vehicles.*.model="{}/lab/x.toml"'),
        ("vehicles.a={model='x.toml'}", 'vehicles.a={{model = "{}/x.toml"}}'),
        ("vehicles.a.model=atmos", "vehicles.a.model=atmos"),
        ("faults = 'f.toml'", 'faults = "{}/f.toml"'),
        ("controller.law=my.py:Mine", "controller.law=my.py:Mine"),
        ("controller.law='my.py:Mine'", 'controller.law="{}/my.py:Mine"'),
        ("controller={file='p.onnx'}", 'controller={{file = "{}/p.onnx"}}'),
        ("controller={type='python',law='entry'}", "controller={type='python',law='entry'}"),
        ("controller.bandwidth=0.3", "controller.bandwidth=0.3"),
        ("table.tilt.uniform=[0.1,0.0]", "table.tilt.uniform=[0.1,0.0]"),
        ("nonsense", "nonsense"),
    ],
)  # fmt: skip
def test_what_is_a_path(tmp_path, text, placed):
    assert anchored(text, tmp_path) == (placed.format(tmp_path) if placed != text else text)
