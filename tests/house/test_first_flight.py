"""The page that leads from an empty lab to the first hold says what the program does."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from testbed.cli.main import main
from testbed.config import SHIPPED, find, load
from testbed.core.types import Accel, Health, Pose, State, Twist, Vitals
from testbed.flight.arming import ArmingParams, Readiness, arming_checks
from testbed.rig.chain import expected_of

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "first_flight_on_the_table.md").read_text()
COMMANDS = [
    shlex.split(line, comments=True)
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]
TESTBED = [words[1:] for words in COMMANDS if words[:1] == ["testbed"]]
TOML = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """The three files of section 1, changed as it says."""
    monkeypatch.chdir(tmp_path)
    Path("configs").symlink_to(SHIPPED)
    for words in COMMANDS[:4]:
        if words[0] == "mkdir":
            Path(words[1]).mkdir()
        else:
            assert words[0] == "cp"
            shutil.copyfile(words[1], words[2])
    hold = Path("lab/hold.toml")
    text = hold.read_text()
    for kind, new in (("tables/marble_6m", "table"), ("vehicles/generic_8jet", "sat1")):
        assert f"../{kind}.toml" in text
        text = text.replace(f"../{kind}.toml", f"{new}.toml")
    hold.write_text(text)
    return hold


def test_the_three_files_are_an_experiment(lab):
    result = CliRunner().invoke(main, ["check", str(lab)])
    assert result.exit_code == 0, result.output


def test_its_tables_are_what_a_table_file_takes(lab):
    assert len(TOML) == 2
    table = Path("lab/table.toml")
    table.write_text("\n".join([table.read_text(), *TOML]))
    there = load(lab).table.lab
    assert there.mocap.bodies == {"sat1": "Rigid Body 1"}
    assert there.serial.ports.keys() == {"sat1"}


@pytest.mark.parametrize("words", TESTBED, ids=shlex.join)
def test_its_commands_are_understood(words):
    verb = main.commands[words[0]]
    with verb.make_context(words[0], [w.replace("lab/hold.toml", "hold") for w in words[1:]]):
        pass


def test_every_check_is_explained_and_no_other():
    blind = Readiness(0.0, None, 0.0, None, Vitals(), 0.0, valves_shut=False, neighbours={})
    still = State(0.0, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0), 0.0, 0)
    seen = Readiness(0.0, still, 0.0, Health(0.0, 0.0, 0.0), Vitals(), 0.0, False, {"sat2": still})
    experiment = load(find("zhang2023_table"))
    checks = [
        check.name.removeprefix("sat1 ")
        for ready in (blind, seen)
        for check in arming_checks(ready, expected_of(experiment, "sat1"), ArmingParams())
    ]
    rows = PAGE.split("| red | means | do |")[1]
    names = re.findall(r"^\| `([^`]+)`", rows, re.MULTILINE)
    explained = {name.partition(":")[0] for name in names}
    assert {re.sub("sat2", "NAME", name) for name in checks} == explained


def test_checks_that_a_rig_adds_are_explained():
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "testbed/rig").rglob("*.py")]
    added = {name for text in sources for name in re.findall(r"\bCheck\(\"(\w+)\"", text)}
    assert {"commissioned", "frame"} <= added
    explained = set(re.findall(r"^\| `(\w+)[`:]", PAGE, re.MULTILINE))
    assert added <= explained
