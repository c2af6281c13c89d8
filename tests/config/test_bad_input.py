"""Bad input: exit code 2, one message that says where, which key, what was expected and what was
found; no traceback, nothing on stdout, nothing written."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, get_args

import pytest
from click.testing import CliRunner

from controllers.catalogue import Controller
from testbed.cli.main import main
from testbed.config import SHIPPED

LAWS = ", ".join(law.__struct_config__.tag for law in get_args(Controller))


class Message(NamedTuple):
    """An error message, taken apart."""

    where: str
    key: str
    expected: str
    found: str


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def everything_in(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b""
        for path in folder.rglob("*")
    }


SCENARIOS = Path(__file__).resolve().parents[2] / "configs/scenarios"


def refused(experiment: str | Path, overrides: Sequence[str] = ()) -> Message:
    """The message of `testbed run` and `testbed check`, which must be the same."""
    before = everything_in(Path())
    outputs = []
    for verb in ("run", "check"):
        result = CliRunner().invoke(main, [verb, str(experiment), *overrides])
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert isinstance(result.exception, SystemExit)
        outputs.append(result.stderr)
    assert outputs[0] == outputs[1]
    assert everything_in(Path()) == before
    form = r"error: (.*)\n(?:  key       (.*)\n)?  expected  (.*)\n  found     (.*)\n"
    match = re.fullmatch(form, outputs[0])
    assert match, outputs[0]
    return Message(*(part or "" for part in match.groups()))


TYPOS = {
    "nmae=x": "name",
    "vehicle.sat1.start=[0,0,0]": "vehicles",
    "vehicles.sat1.strat=[0,0,0]": "start",
    "vehicles.*.model.masss=3": "mass",
    "vehicles.sat1.model.jets.4.psh=[1,0]": "push",
    "vehicles.sat1.model.valve.open_dely_s=0": "open_delay_s",
    "vehicles.sat1.model.air.gass=1": "gas",
    "vehicles.sat1.model.tolerance.thurst=0": "thrust",
    "table.sise=[1,1]": "size",
    "table.tilt.unifrom=[0,0]": "uniform",
    "table.mocap.ratehz=3": "rate_hz",
    "table.link.dealy_s=0": "delay_s",
    "obstacles.o1.raduis=1": "radius",
    "obstacle={}": "obstacles",
    "controller.lamda=1": "lambda",
    "controller.potential.standof=3": "standoff",
    "controller.scale.tme=3": "time",
    "guidance.mod=wrench": "mode",
    "flight.jet_period=0.1": "jet_period_s",
    "flight.modulator={type='pwpf',lag=3}": "lag_s",
    "flight.estimator.gate_sigm=3": "gate_sigma",
    "flight.tracker.dampin=1": "damping",
    "flight.allocator.prioritty='force'": "priority",
    "flight.gate.fence_margn=0": "fence_margin",
    "deploy.lw=host": "law",
    "criteria.max_contact=1": "max_contacts",
}


@pytest.mark.parametrize(("override", "meant"), TYPOS.items())
def test_a_typo_in_a_key(override: str, meant: str) -> None:
    message = refused("zhang2023_table", [override])
    assert message.where == f"command line: {override}"
    assert meant in re.findall(r"\w+", message.expected)
    assert re.fullmatch(rf"unknown key `\w+` \(did you mean `{meant}`\?\)", message.found)


def test_a_key_far_from_any() -> None:
    message = refused("hold", ["foo=1"])
    assert message.key == "foo"
    assert message.expected.startswith("one of: arming, board, controller, ")
    assert message.found == "unknown key `foo`"


CHOICES = {
    "deploy.law=hots": ("host", '"hots" (did you mean `host`?)'),
    "controller.type=sotmsc": ("sotsmc", '"sotmsc" (did you mean `sotsmc`?)'),
    "controller.type=x": ("sotsmc", '"x"'),
    "controller.type=[1]": ("sotsmc", "[1]"),
    "controller.type=3": ("sotsmc", "3"),
    "controller={}": ("sotsmc", "nothing: the key is missing"),
    "flight.modulator.type=pwn": ("pwm", '"pwn" (did you mean `pwm`?)'),
    "guidance.mode=wrnch": ("wrench", '"wrnch" (did you mean `wrench`?)'),
    "guidance.mode=true": ("wrench", "true"),
    "deploy.law=cloud": ("host", '"cloud"'),
    "flight.allocator.priority=both": ("torque", '"both"'),
}


@pytest.mark.parametrize("override", CHOICES)
def test_a_wrong_choice(override: str) -> None:
    choice, found = CHOICES[override]
    message = refused("zhang2023_table", [override])
    assert message.where == f"command line: {override}"
    assert message.expected.startswith("one of: ")
    assert choice in message.expected.removeprefix("one of: ").split(", ")
    assert message.found == found


TOML_VALUE = """a TOML value: a number, a word, [...], {...}, or text in quotes, 'key="..."'"""
ENTRIES = (
    "name, description, duration_s, table, vehicles, obstacles, controller, guidance, deploy,"
    " criteria, faults"
)

WRONG = {  # override: (key if it is not that of the override, expected, found)
    # wrong types, however deep
    "name=7": ("", "a string", "7"),
    "name=2024-01-01": ("", "a string", "2024-01-01"),
    "name=[]": ("", "a string", "[]"),
    "description={a=1}": ("", "a string", "{a = ...}"),
    "duration_s=long": ("", "a number > 0", '"long"'),
    "duration_s=true": ("", "a number > 0", "true"),
    "seed=1.5": ("", "a whole number >= 0 and <= 9223372036854775807", "1.5"),
    "seed=true": ("", "a whole number >= 0 and <= 9223372036854775807", "true"),
    "criteria.max_contacts=0.5": ("", "a whole number >= 0", "0.5"),
    "criteria.clear_of_obstacles=1": ("", "true or false", "1"),
    "controller=pd": ("", f"a table whose `type` is one of: {LAWS}", '"pd"'),
    "controller.lambda=x": ("", "a number > 0 or a list, each entry a number > 0", '"x"'),
    "controller.lambda=[1,'x']": ("controller.lambda.2", "a number > 0", '"x"'),
    "vehicles=3": ("", "a table", "3"),
    "vehicles=[]": ("", "a table", "[]"),
    "vehicles.sat1=here": ("", "a table", '"here"'),
    "vehicles.sat1.model=3": ("", "a table or the path of a TOML file", "3"),
    "vehicles.sat2.start=[0,0]": ("", "a list of 3, each a number", "[0, 0]"),
    "vehicles.sat2.start=here": ("", "a list of 3, each a number", '"here"'),
    "vehicles.sat2.start=true": ("", "a list of 3, each a number", "true"),
    "vehicles.sat2.start=[0,0,true]": ("vehicles.sat2.start.3", "a number", "true"),
    "vehicles.sat1.model.jets={}": ("", "a list, each entry a table", "{}"),
    "vehicles.sat1.model.jets.4=7": ("", "a table", "7"),
    "vehicles.sat1.model.jets.4.push='up'": ("", "a list of 2, each a number", '"up"'),
    "vehicles.sat1.model.jets.4.push=[1,0,0]": ("", "a list of 2, each a number", "[1, 0, 0]"),
    "vehicles.sat1.model.jets.4.push=[1,'x']": (
        "vehicles.sat1.model.jets.4.push.2", "a number", '"x"',
    ),
    "table=7": ("", "a table or the path of a TOML file", "7"),
    "table.tilt.map=[[[0,0],[0,'x']]]": ("table.tilt.map.1.2.2", "a number", '"x"'),
    "obstacles.o1.velocity=[1]": ("", "a list of 2, each a number", "[1]"),
    "obstacles=no": ("", "a table", '"no"'),
    # missing
    "vehicles.sat4.start=[0,0,0]": (
        "vehicles.sat4.model", "a table or the path of a TOML file",
        "nothing: the key is missing; missing as well: goal",
    ),
    "obstacles.o3.position=[2,2]": (
        "obstacles.o3.radius", "a number > 0", "nothing: the key is missing",
    ),
    "vehicles={}": ("", "at least one vehicle", "none"),
    # not finite, or too large to be meant
    "duration_s=nan": ("", "a finite number", "nan"),
    "duration_s=-inf": ("", "a finite number", "-inf"),
    "vehicles.sat2.start=[0,nan,0]": ("vehicles.sat2.start.2", "a finite number", "nan"),
    "vehicles.sat1.model.jets.4.thrust=inf": ("", "a finite number", "inf"),
    "table.tilt.map=[[[0,nan]]]": ("table.tilt.map.1.1.2", "a finite number", "nan"),
    "controller.eta=inf": ("", "a finite number", "inf"),
    "foo.bar=[{x=nan}]": ("foo.bar.1.x", "a finite number", "nan"),
    "vehicles.sat2.goal=[1e308,-1e308,0]": (
        "vehicles.sat2.goal.1", "a number of at most 1e+09", "1e+308",
    ),
    "vehicles.*.model.mass=1e308": (
        "vehicles.sat1.model.mass", "a number of at most 1e+09", "1e+308",
    ),
    f"duration_s=1{'0' * 400}": (
        "", "a number of at most 1e+09", "a whole number of 1329 bits",
    ),
    f"controller.k=0x{'f' * 5000}": (
        "", "a number of at most 1e+09", "a whole number of 20000 bits",
    ),
    "seed=18446744073709551616": (
        "", "a whole number >= 0 and <= 9223372036854775807", "18446744073709551616",
    ),
    # out of range
    "seed=-1": ("", "a whole number >= 0 and <= 9223372036854775807", "-1"),
    "duration_s=0": ("", "a number > 0", "0"),
    "duration_s=-3.0": ("", "a number > 0", "-3.0"),
    "vehicles.*.model.mass=-1": ("vehicles.sat1.model.mass", "a number > 0", "-1"),
    "vehicles.sat3.model.mass=0": ("", "a number > 0", "0"),
    "vehicles.sat1.model.jets.4.thrust=0": ("", "a number > 0", "0"),
    "vehicles.sat1.model.valve.open_ramp_s=-1e-3": ("", "a number >= 0", "-0.001"),
    "table.size=[0,1]": ("table.size.1", "a number > 0", "0"),
    "table.restitution=1.1": ("", "a number >= 0 and <= 1", "1.1"),
    "table.link.loss=-0.1": ("", "a number >= 0 and <= 1", "-0.1"),
    "controller.lambda=0": ("", "a number > 0 or a list, each entry a number > 0", "0"),
    "guidance.step_s=0.01": ("", "a number > 0 and <= 0.001", "0.01"),
    "criteria.settle_s=-1": ("", "a number > 0", "-1"),
    "criteria.max_contacts=-1": ("", "a whole number >= 0", "-1"),
    # values that do not fit each other
    "controller={type='sotsmc',p=1}": ("controller", "1 < p/q < 2", "p/q = 0.333333"),
    "controller={type='sotsmc',lambda=[1]}": ("", "2 diagonal elements or one number", "1"),
    "flight.modulator={type='pwpf',trigger_off=2}": (
        "", "trigger_off < trigger_on < gain", "2, 1, 50",
    ),
    "flight.modulator={type='pwpf',gain=0.5}": ("", "trigger_off < trigger_on < gain", "0, 1, 0.5"),
    # names
    "name='../x'": (
        "", "at most 64 letters, digits, `_`, `-`, `.`, the first a letter or digit", '"../x"',
    ),
    "name=''": (
        "", "at most 64 letters, digits, `_`, `-`, `.`, the first a letter or digit", '""',
    ),
    "name='/etc/x'": (
        "", "at most 64 letters, digits, `_`, `-`, `.`, the first a letter or digit", '"/etc/x"',
    ),
    'name="a\\u001b[31m"': (
        "", "at most 64 letters, digits, `_`, `-`, `.`, the first a letter or digit",
        '"a\\x1b[31m"',
    ),
    "obstacles.sat1={position=[2,2],radius=0.1}": ("", "a name that no vehicle has", '"sat1"'),
    "obstacles.table={position=[2,2],radius=0.1}": (
        "", "a name that is not one of: host, operator, table, truth", '"table"',
    ),
    'obstacles."a.b c/\u00e9"={position=[2,2],radius=0.1}': (
        'obstacles."a.b c/\u00e9"', "a name of at most 32 letters, digits, `_`, `-`",
        '"a.b c/\u00e9"',
    ),
    # places
    "vehicles.sat2.start=[9,9,0]": ("", "a place on the table, |x| <= 2.8 m and |y| <= 2.8 m",
                                    "(9, 9)"),
    "vehicles.sat2.goal=[0,2.81,0]": ("", "a place on the table, |x| <= 2.8 m and |y| <= 2.8 m",
                                      "(0, 2.81)"),
    "vehicles.sat2.start=[0,-1.4,90]": (
        "vehicles.sat2.start.3", "a heading in radians, at most 2 pi", "90",
    ),
    "vehicles.sat2.start=[1.4,-1.2,0]": ("", "at least 0.4 m from sat1's start",
                                         "0.200 m: they overlap"),
    "vehicles.sat2.goal=[1.818,1.915,0]": ("", "at least 0.4 m from sat1's goal",
                                           "0.000 m: they overlap"),
    "vehicles.sat2.start=[0.9,0.9,0]": ("", "outside obstacle o2, at least 0.8 m from its centre",
                                        "0.100 m"),
    "vehicles.sat2.goal=[0.9,0.9,0]": ("", "outside obstacle o2, at least 0.8 m from its centre",
                                       "0.100 m"),
    "obstacles.o1.solid=0.9": ("", "at most the danger radius, 0.8 m", "0.9 m"),
    "table.size=[6000,6000]": ("table.size.1", "metres, at most 100", "6000"),
    "table.tilt.uniform=[1.7,1]": ("", "m/s^2, at most 1: a slope of 6 degrees", "1.97231"),
    "table.tilt.map=[[[0,0],[0,0]],[[0,0],[0,50]]]": (
        "table.tilt.map.2.2", "m/s^2, at most 1: a slope of 6 degrees", "50",
    ),
    "table.tilt.map=[[[0,0],[0,0]],[[0,0]]]": ("", "rows of equal length", "lengths [1, 2]"),
    "table.tilt.map=[[[0,0],[0,0]]]": (
        "", "at least 2 rows of 2 nodes, from edge to edge of the table", "1 x 2",
    ),
    "table.tilt.map=[[]]": (
        "", "at least 2 rows of 2 nodes, from edge to edge of the table", "1 x 0",
    ),
    # vehicles
    "vehicles.sat1.model.radius=7": ("", "a vehicle that fits on the table of 6 m x 6 m", "7 m"),
    "vehicles.sat1.model.com=[0.3,0]": (
        "", "a point of the vehicle, at most 0.2 m from its origin", "[0.3, 0.0]",
    ),
    "vehicles.sat1.model.inertia=2": ("", "at most 0.5 kg m^2: 12.5 kg within 0.2 m", "2 kg m^2"),
    "vehicles.sat1.model.inertia=1e-9": (
        "", "at least 5e-05 kg m^2, or the mass is a point", "1e-09 kg m^2",
    ),
    "vehicles.sat1.model.com=[0.18,0]": (
        "", "at most 0.155 m from the origin: 12.5 kg within 0.2 m with an inertia of 0.2 kg m^2"
        " are not further off", "[0.18, 0.0]",
    ),
    "vehicles.sat1.model.drag=50": ("", "at most 25: with more it does not float", "50"),
    "vehicles.sat1.model.spin_drag=3": ("", "at most 2: with more it does not float", "3"),
    "vehicles.sat1.model.jets=[]": (
        "", "jets that push the body every way and turn it both ways",
        "0: none towards +x; none towards -x; none towards +y; none towards -y; none turning left;"
        " none turning right",
    ),
    "vehicles.sat1.model.jets.4.push=[1,1]": ("", "a vector of length 1", "[1.0, 1.0]"),
    "vehicles.sat1.model.jets.4.position=[15,9]": (
        "", "a point of the vehicle, at most 0.2 m from its origin", "[15.0, 9.0]",
    ),
    "vehicles.sat1.model.air.gas=6.25": ("", "less than half of the mass, 6.25 kg", "6.25 kg"),
    "vehicles.sat1.model.air.tank_position=[0.5,0]": (
        "", "at most 0.447214 m from `com`, or the gas has the vehicle's inertia", "[0.5, 0.0]",
    ),
    "vehicles.sat1.model.air.tank_pressure=200": (
        "", "at least set_pressure + dropout, 600000 Pa", "200 Pa",
    ),
    "vehicles.sat1.model.gauges={battery=false,undervoltage_v=9.0}": (
        "vehicles.sat1.model.gauges.undervoltage_v", "0 without a voltmeter (`battery = false`)",
        "9 V",
    ),
    "vehicles.sat1.model.gauges.battery_v=24000": ("", "volts, at most 60", "24000"),
    "vehicles.sat1.model.gauges.undervoltage_v=20": (
        "", "volts, at most those of the battery, battery_v = 12", "20",
    ),
    "vehicles.sat1.model.tolerance.thrust=5": ("", "a share, at most 0.5: 5 % is 0.05", "5"),
    "vehicles.sat1.model.tolerance.direction_deg=57": ("", "degrees, at most 20", "57"),
    "vehicles.sat1.model.tolerance.com=1": ("", "at most the radius, 0.2 m", "1 m"),
    "vehicles.sat1.model.valve.min_on_s=10": ("", "at most flight.jet_period_s, 0.1 s", "10 s"),
    "vehicles.sat1.model.valve.open_delay_s=6": (
        "", "at most 2 times flight.jet_period_s, 0.2 s", "6 s",
    ),
    "vehicles.sat1.model.valve.open_delay_s=0.15": (
        "", "less than 0.106 s, or nothing flows in a jet period", "0.15 s",
    ),
    "vehicles.sat1.model.command_delay_s=2": ("", "at most flight.jet_period_s, 0.1 s", "2 s"),
    # times and rates
    "duration_s=0.01": ("", "at least flight.jet_period_s, 0.1 s", "0.01 s"),
    "duration_s=1e6": ("", "at most 1000000 jet periods, 100000 s", "1e+06 s"),
    "duration_s=9e4": (
        "", "at most 5000 s: then the bearings of sat1 have used all its gas", "90000 s",
    ),
    "flight.jet_period_s=1e-6": ("", "at least 0.001 s", "1e-06 s"),
    "table.mocap.rate_hz=1e5": ("", "at most 10000 Hz", "100000 Hz"),
    "table.mocap.rate_hz=2": ("", "more than 2.08 Hz: the gate waits 0.5 s for a pose", "2 Hz"),
    "obstacles.--child={position=[2,2],radius=0.1}": (
        "obstacles.--child", "a name that begins with a letter, a digit or `_`", '"--child"',
    ),
    "table.lab.mocap.bodies={sat1='A',sat2='A'}": (
        "table.lab.mocap.bodies.sat2", "a body for sat1 and another for sat2", '"A"',
    ),
    "table.lab.mocap.bodies={sat1='sat3'}": (
        "table.lab.mocap.bodies.sat1", "a body for sat1 and another for sat3", '"sat3"',
    ),
    "table.lab.serial.ports={sat1='/dev/x',sat3='/dev/x'}": (
        "table.lab.serial.ports.sat3", "another port than that of sat1", '"/dev/x"',
    ),
    "table.lab.mocap.interface='::1'": (
        "", "an IPv4 address of the vehicle's computer, or 0.0.0.0: whichever leads there",
        '"::1"',
    ),
    "table.lab.mocap.group='192.168.1.7'": (
        "", "the IPv4 address of a group, from 224.0.0.0 to 239.255.255.255", '"192.168.1.7"',
    ),
    "table.lab.mocap.server='a b'": (
        "", "the name or the IPv4 address of the machine that the cameras' program runs on",
        '"a b"',
    ),
    "table.lab.mocap.server='10.0.0.300'": (
        "", "the name or the IPv4 address of the machine that the cameras' program runs on",
        '"10.0.0.300"',
    ),
    "table.lab.network.endpoint='foo/127.0.0.1:7450'": (
        "", "PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7450", '"foo/127.0.0.1:7450"',
    ),
    "table.lab.network.endpoint='tcp/127.0.0.1:99999'": (
        "", "PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7450", '"tcp/127.0.0.1:99999"',
    ),
    "table.mocap.latency_s=20": ("", "less than flight.gate.pose_timeout_s, 0.5 s", "20 s"),
    "guidance.step_s=1e-9": ("", "at least 1e-05 s, 10000 steps in a jet period", "1e-09 s"),
    "guidance.preview_s=1e6": ("", "at most 100 jet periods, 10 s", "1e+06 s"),
    # keys that cannot be
    "name.foo=1": ("name", "a table", '"zhang2023_table"'),
    "nowhere.*.x=1": ("nowhere", f"one of: {ENTRIES}", "no `nowhere`"),
    "vehicle.*.model.mass=3": (
        "vehicle", f"one of: {ENTRIES}", "no `vehicle` (did you mean `vehicles`?)",
    ),
    "vehicles.*.models.*.mass=3": (
        "vehicles.sat1.models", "one of: model, start, goal",
        "no `models` (did you mean `model`?)",
    ),
    "vehicles.sat1.model.jets.9.thrust=1": (
        "vehicles.sat1.model.jets", "a number from 1 to 8, an entry of `jets`", "9",
    ),
    "vehicles.sat1.model.jets.0.thrust=1": (
        "vehicles.sat1.model.jets", "a number from 1 to 8, an entry of `jets`", "0",
    ),
    "table.size.3=1": (
        "table.size", "a number from 1 to 2, an entry of `size`", "3",
    ),
    "table.size.x=1": (
        "table.size", "a number from 1 to 2, an entry of `size`", "x",
    ),
    # values that cannot be
    "name=": ("", TOML_VALUE, "nothing"),
    "name=two words": ("", TOML_VALUE, '"two words"'),
    'name="x': ("", TOML_VALUE, '"\\"x"'),
    "controller.lambda=[1,x]": ("", TOML_VALUE, '"[1,x]"'),
    "seed=1\nname='b'": ("", TOML_VALUE, '"1\\nname=\'b\'"'),
    f"seed={'9' * 5000}": ("", TOML_VALUE, '"' + "9" * 68 + "..."),
    f"controller.k={'[' * 1000}": ("", TOML_VALUE, '"' + "[" * 68 + "..."),
    f"controller.k={'[' * 40}{']' * 40}": ("", TOML_VALUE, '"' + "[" * 40 + "]" * 28 + "..."),
}  # fmt: skip


@pytest.mark.parametrize("override", WRONG, ids=lambda text: text[:60])
def test_a_wrong_value(override: str) -> None:
    key, expected, found = WRONG[override]
    message = refused("zhang2023_table", [override])
    assert message.where.startswith("command line: ")
    assert message.key == (key or override.partition("=")[0])
    assert message.expected == expected
    assert message.found == found


@pytest.mark.parametrize(
    "override",
    ["foo", "", "=3", "a..b=3", ".a=3", "a.=3", "a b=3", '"a=3', '"\\q"=3', "\udcff=1",
     "name=\udcff"],
    ids=lambda text: ascii(text[:20]),
)  # fmt: skip
def test_not_key_value(override: str) -> None:
    message = refused("hold", [override])
    assert message.where == "command line"
    assert message.expected == "key=value"


def test_a_key_of_too_many_parts() -> None:
    message = refused("hold", [".".join("a" * 60_000) + "=1"])
    assert message.expected == "key=value with a key of at most 32 parts"


@pytest.mark.parametrize("override", ["[0]=3", "a[x]=3", "vehicles.sat1.model.jets[0].thrust=1"])
def test_jets_count_from_1_and_have_no_brackets(override: str) -> None:
    message = refused("hold", [override])
    assert message.expected == (
        "key=value with `jets.1` for the first entry of a list, `jets.*` for all"
    )


@pytest.mark.parametrize(
    ("override", "where", "key"),
    [  # the mistake shows at another key than the one that was changed
        ("controller.lambda=[1]", "zhang2023_table.toml with command line: ", "controller"),
        ("controller.p=1", "zhang2023_table.toml with command line: ", "controller"),
        ("controller.scale.time=1e-200", "zhang2023_table.toml with command line: ", "controller"),
        ("vehicles.sat1.model.jets.*.push=[1,0]", "generic_8jet.toml with command line: ", "jets"),
        ("flight.jet_period_s=200", "zhang2023_table.toml", "duration_s"),
        ("flight.jet_period_s=0.005", "generic_8jet.toml", "valve.min_on_s"),
        ("flight.gate.fence_margin=1.2", "zhang2023_table.toml", "vehicles.sat1.goal"),
        ("table={}", "command line: table={}", "table.size"),
        ("table.size=[2,2]", "zhang2023_table.toml", "vehicles.sat1.start"),
    ],
)
def test_where_a_mistake_is(override: str, where: str, key: str) -> None:
    message = refused("zhang2023_table", [override])
    assert where in message.where
    assert message.key == key


def test_more_camera_frames_than_fit_into_memory() -> None:
    message = refused("hold", ["duration_s=4000", "table.mocap.rate_hz=9000"])
    assert message == (
        "command line: table.mocap.rate_hz=9000", "table.mocap.rate_hz",
        "at most 1e+07 frames in 4000 s", "3.6e+07",
    )  # fmt: skip


def test_the_last_override_is_the_one_to_mend() -> None:
    message = refused("hold", ["table.size=[-1,1]", "table.size.2=2", "table={size=[-3,1]}"])
    assert message == (
        "command line: table={size=[-3,1]}", "table.size.1", "a number > 0", "-3"
    )  # fmt: skip


# Files


HOLD = (SHIPPED / "experiments" / "hold.toml").read_text().replace('"../', f'"{SHIPPED}/')
TABLE = (SHIPPED / "tables" / "marble_6m.toml").read_text()
FLOATER = (SHIPPED / "vehicles" / "generic_8jet.toml").read_text()

BROKEN_FILES = {  # content: found
    "name = 'a'\nname = 'b'\n": r"Cannot overwrite a value \(.*\)",
    "[a]\n[a]\n": r"Cannot declare \('a',\) twice \(.*\)",
    "name = \n": r"Invalid value \(.*\)",
    "name = 'x' y\n": r"Expected newline or end of document after a statement \(.*\)",
    b"name = '\xff\xfe'\n": r"'utf-8' codec can't decode byte 0xff .*",
    b"\x7fELF\x00\x00": r"Invalid statement \(.*\)",
    f"x = {'9' * 5000}\n": r"Exceeds the limit \(4300 digits\) .*",
    f"x = {'[' * 5000}{']' * 5000}\n": r"more than 32 tables or lists in each other",
    f"x = {'[' * 40}{']' * 40}\n": r"more than 32 tables or lists in each other",
    f"x = {'{a.a.a.a=' * 12}1{'}' * 12}\n": r"more than 32 tables or lists in each other",
    ".".join("a" * 200_000) + " = 1\n": "a key of more than 32 parts",
    "[" + " . ".join(["abc"] * 100_000) + "]\n": "a key of more than 32 parts",
    "# " + "x" * 10_000_000: "more than 1 MB",
}


@pytest.mark.parametrize("content", BROKEN_FILES, ids=lambda content: ascii(content[:20]))
@pytest.mark.parametrize("slot", ["experiment", "table", "vehicle"])
def test_a_file_that_is_not_toml(slot: str, content: str | bytes) -> None:
    data = content if isinstance(content, bytes) else content.encode()
    Path("broken.toml").write_bytes(data)
    text = HOLD.replace(f"{SHIPPED}/tables/marble_6m.toml", "broken.toml" * (slot == "table"))
    if slot == "vehicle":
        text = HOLD.replace(f"{SHIPPED}/vehicles/generic_8jet.toml", "broken.toml")
    Path("experiment.toml").write_text(text)
    message = refused("broken.toml" if slot == "experiment" else "experiment.toml")
    assert message.where == ("" if slot == "experiment" else f"{Path().resolve()}/") + "broken.toml"
    assert (message.key, message.expected) == ("", "a TOML file")
    assert re.fullmatch(BROKEN_FILES[content], message.found)


def path_or_name(kind: str) -> str:
    """What a key for a table or a vehicle expects."""
    names = sorted(file.stem for file in (SHIPPED / kind).glob("*.toml"))
    return f"the path of a TOML file, or one of: {', '.join(names)}"


@pytest.mark.parametrize(
    ("slot", "key", "value", "found"),
    [
        ("tables/marble_6m", "table", "nowhere.toml", '"nowhere.toml": no such file'),
        ("tables/marble_6m", "table", ".", '".": it is a folder'),
        ("tables/marble_6m", "table", "", '"": it is a folder'),
        ("tables/marble_6m", "table", "x" * 300, f'"{"x" * 68}...: File name too long'),
        ("tables/marble_6m", "table", "\\u0000", '"\\x00": no such file'),
        ("vehicles/generic_8jet", "vehicles.sat1.model", "n.toml", '"n.toml": no such file'),
        ("vehicles/generic_8jet", "vehicles.sat1.model", "..", '"..": it is a folder'),
    ],
)
def test_an_included_file_that_is_none(slot: str, key: str, value: str, found: str) -> None:
    Path("experiment.toml").write_text(HOLD.replace(f"{SHIPPED}/{slot}.toml", value))
    message = refused("experiment.toml")
    assert message == ("experiment.toml", key, path_or_name(slot.split("/")[0]), found)


@pytest.mark.parametrize("value", ["nowhere.toml", "/nowhere/x.toml", "./nowhere.toml", "../here"])
def test_a_table_on_the_command_line_that_is_none(value: str) -> None:
    trouble = "it is a folder" if value == "../here" else "no such file"
    message = refused("hold", [f"table={value}"])
    assert message == (
        f"command line: table={value}", "table", path_or_name("tables"),
        f'"{value}": {trouble}',
    )  # fmt: skip


@pytest.mark.parametrize(
    ("override", "kind", "meant"),
    [
        ("table=rouhg_4m", "tables", "rough_4m"),
        ("table=tables/marble6m.toml", "tables", "marble_6m"),
        ("vehicles.sat1.model=generic_jet", "vehicles", "generic_8jet"),
        ("vehicles.sat1.model=rough_4m", "vehicles", None),  # of another kind
    ],
)
def test_a_name_of_no_shipped_file(override: str, kind: str, meant: str | None) -> None:
    key, value = override.split("=")
    hint = f" (did you mean `{meant}`?)" if meant else ""
    assert refused("hold", [override]) == (
        f"command line: {override}", key, path_or_name(kind), f'"{value}": no such file{hint}',
    )  # fmt: skip


def test_a_fault_table_has_no_name() -> None:
    message = refused("hold", ["faults=faults"])
    assert (message.expected, message.found) == (
        "the path of a TOML file", '"faults": no such file',
    )  # fmt: skip


def test_a_mistake_in_an_included_file() -> None:
    Path("slow.toml").write_text(TABLE.replace("rate_hz = 100.0", "rate_hz = 'fast'"))
    message = refused("hold", ["table=slow.toml"])
    where = str(Path("slow.toml").resolve())
    assert message == (where, "mocap.rate_hz", "a number > 0", '"fast"')


def test_a_mistake_in_a_jet_of_an_included_file() -> None:
    Path("odd.toml").write_text(FLOATER.replace("thrust = 0.6", "thrust = -0.6", 4))
    message = refused("zhang2023_table", ["vehicles.sat2.model=odd.toml"])
    assert message == (str(Path("odd.toml").resolve()), "jets.1.thrust", "a number > 0", "-0.6")


@pytest.mark.parametrize("kind", ["experiment", "vehicle", "table"])
def test_an_experiment_in_the_place_of_its_parts(kind: str) -> None:
    text = {"experiment": HOLD, "vehicle": FLOATER, "table": TABLE}[kind]
    Path("x.toml").write_text(text)
    message = refused("x.toml", ["table=x.toml"] if kind == "experiment" else [])
    assert message.found.startswith("unknown key `")


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("zhang2023_tabel", "no such file (did you mean `zhang2023_table`?)"),
        ("configs/experiments/hould.toml", "no such file (did you mean `hold`?)"),
        ("", "it is a folder"),
        ("..", "it is a folder"),
        ("x" * 300, "File name too long"),
        ("nothing/like/it", "no such file"),
        ("step", f"no such file (a scenario of the benchmark? its file is {SCENARIOS}/step.toml)"),
        ("../experiments/hold", "no such file (did you mean `hold`?)"),
        ("/dev/null/x", "no such file"),
    ],
)
def test_an_experiment_that_is_none(name: str, found: str) -> None:
    message = refused(name)
    assert message.where == name
    assert message.expected.startswith("an experiment file or one of: ")
    assert "hold, " in message.expected
    assert message.found == found


def test_an_empty_file() -> None:
    Path("empty.toml").touch()
    message = refused("empty.toml")
    found = "nothing: the key is missing; missing as well: duration_s, table, vehicles, controller"
    assert message == ("empty.toml", "name", "a string", found)


def test_a_pipe_is_not_a_file() -> None:
    os.mkfifo("pipe.toml")
    result = CliRunner().invoke(main, ["check", "pipe.toml"])
    assert result.exit_code == 2
    assert "no such file" in result.stderr


def test_a_long_unknown_key_is_cut() -> None:
    Path("experiment.toml").write_text(f"{'k' * 100_000} = 1\n{HOLD}")
    message = refused("experiment.toml")
    assert len("".join(message)) < 1000


@pytest.mark.parametrize("name", ["sat-1", "1"])
def test_a_vehicle_whose_name_ros_2_refuses(here: Path, name: str) -> None:
    text = (SHIPPED / "experiments" / "hold.toml").read_text()
    text = text.replace("vehicles.sat1", f'vehicles."{name}"').replace("../vehicles/", "")
    (here / "own.toml").write_text(text.replace("../tables/", "").replace("_6m.toml", "_6m")
                                   .replace("_8jet.toml", "_8jet"))  # fmt: skip
    message = refused("own.toml", ["table.lab.network.ros2=true"])
    assert message.expected == "a name for topics of ROS 2: letters, digits and _, no digit first"
    assert (message.key, message.found) == (f"vehicles.{name}", f'"{name}"')
