"""Experiment files are found, read, changed by overrides and written back."""

import math
from pathlib import Path

import pytest
import tomli_w

from testbed.config import SHIPPED, ConfigError, Experiment, dump, find, load, loads, read_toml
from testbed.flight.modulation import PwmParams

NAMES = sorted(path.stem for path in (SHIPPED / "experiments").glob("*.toml"))


def hold(*overrides: str) -> Experiment:
    return load(find("hold"), overrides)


# Found


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_experiment_is_found_by_name(name):
    assert load(find(name)).name == name


def test_a_file_comes_before_a_shipped_name_but_a_folder_does_not(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("hold").mkdir()
    assert find("hold") == SHIPPED / "experiments" / "hold.toml"
    Path("hold").rmdir()
    Path("hold").write_text("")
    assert find("hold") == Path("hold")


# Read


def test_a_path_is_relative_to_the_file_that_says_so(tmp_path, tree):
    (tmp_path / "parts" / "deep").mkdir(parents=True)
    (tmp_path / "parts" / "t.toml").write_text(tomli_w.dumps(tree["table"]))
    tree["table"] = "../t.toml"
    path = tmp_path / "parts" / "deep" / "e.toml"
    path.write_text(tomli_w.dumps(tree))
    assert load(path) == load(find("zhang2023_table"))


def test_a_path_on_the_command_line_is_relative_to_the_current_folder(tmp_path, monkeypatch):
    text = (SHIPPED / "tables" / "marble_6m.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("0.4 ", "0.25 "))
    monkeypatch.chdir(tmp_path)
    for value in ("mine.toml", "./mine.toml", "'mine.toml'", f"{tmp_path}/mine.toml"):
        assert hold(f"table={value}").table.restitution == 0.25


def test_shipped_tables_and_vehicles_are_found_by_name(tmp_path, tree):
    folder = SHIPPED.as_posix()
    meant = load(
        find("zhang2023_table"),
        [f"table={folder}/tables/rough_6m.toml", f"vehicles.sat1.model={folder}/vehicles/uky.toml"],
    )
    names = ["table=rough_6m", "vehicles.sat1.model=uky"]
    assert load(find("zhang2023_table"), names) == meant
    tree["table"], tree["vehicles"]["sat1"]["model"] = "rough_6m", "uky"
    (tmp_path / "e.toml").write_text(tomli_w.dumps(tree))
    read = load(tmp_path / "e.toml")
    assert (read.table, read.vehicles["sat1"].model) == (meant.table, meant.vehicles["sat1"].model)


def test_a_local_file_comes_before_a_shipped_name_but_a_folder_does_not(tmp_path, monkeypatch):
    text = (SHIPPED / "tables" / "marble_6m.toml").read_text()
    monkeypatch.chdir(tmp_path)
    Path("rough_4m.toml").write_text(text)  # its name has the ending
    Path("rough_6m").mkdir()
    shipped = [hold(f"table={SHIPPED}/tables/rough_{size}.toml") for size in ("4m", "6m")]
    assert [hold("table=rough_4m"), hold("table=rough_6m")] == shipped
    assert hold("table=rough_4m.toml") == hold()
    Path("rough_4m").write_text(text)
    assert hold("table=rough_4m") == hold()


def test_marks_and_line_ends_of_windows_are_read(tmp_path, tree):
    path = tmp_path / "e.toml"
    path.write_bytes(b"\xef\xbb\xbf" + tomli_w.dumps(tree).replace("\n", "\r\n").encode())
    assert load(path) == load(find("zhang2023_table"))


def test_an_integer_is_a_number():
    assert hold("duration_s=3").duration_s == 3.0
    assert hold("vehicles.sat1.start=[0,-1,0]").vehicles["sat1"].start == (0.0, -1.0, 0.0)


# Overrides


def test_overrides_of_the_contract():
    experiment = load(
        find("zhang2023_table"), ["vehicles.sat1.start=[1.4,-1.4,0.0]", "controller.lambda=1.2"]
    )
    assert experiment.vehicles["sat1"].start == (1.4, -1.4, 0.0)
    assert experiment.controller.surface == 1.2


def test_a_bare_word_is_a_string():
    assert hold("name=other").name == "other"
    assert hold("description=a-b_c.d/e").description == "a-b_c.d/e"
    assert hold("board=unicorn").board == "unicorn"
    with pytest.raises(ConfigError) as error:
        hold("wind=none")
    assert error.value.found == "unknown key `wind`"


def test_the_later_one_wins():
    assert hold("seed=1", "seed=2").seed == 2
    assert hold("table.size=[5,5]", "table.size.1=4").table.size == (4.0, 5.0)


def test_a_star_is_every_entry_of_a_table_or_list():
    experiment = load(find("zhang2023_table"), ["vehicles.*.model.jets.*.thrust=0.3"])
    thrusts = {j.thrust for s in experiment.vehicles.values() for j in s.model.jets}
    assert thrusts == {0.3}


def test_entries_of_a_star_are_separate():
    generic = str(SHIPPED / "vehicles" / "generic_8jet.toml")
    experiment = load(
        find("zhang2023_table"), [f"vehicles.*.model={generic}", "vehicles.sat2.model.mass=13.0"]
    )
    masses = [setup.model.mass for setup in experiment.vehicles.values()]
    assert masses == [12.5, 13.0, 12.5]


def test_one_jet_is_changed_by_its_number():
    jets = hold("vehicles.sat1.model.jets.4.thrust=0.3").vehicles["sat1"].model.jets
    assert [jet.thrust for jet in jets] == [0.6] * 3 + [0.3] + [0.6] * 4


def test_tables_that_are_not_in_the_file_are_made():
    experiment = hold("flight.modulator.type=pwm", "obstacles.o1={position=[2,2],radius=0.5}")
    assert experiment.flight.modulator == PwmParams()
    assert experiment.obstacles["o1"].radius == 0.5


def test_a_vehicle_can_be_added():
    generic = SHIPPED / "vehicles" / "generic_8jet.toml"
    experiment = hold(
        f"vehicles.b={{model='{generic}', start=[1,1,0], goal=[1,2,0]}}", "vehicles.b.start.1=2"
    )
    assert experiment.vehicles["b"].start == (2.0, 1.0, 0.0)
    assert experiment.vehicles["b"].model == experiment.vehicles["sat1"].model


# What is allowed although it looks odd


@pytest.mark.parametrize(
    "override",
    [
        "vehicles.sat2.start=[0.1,-1.4,6.28]",  # nearly a whole turn
        "vehicles.sat2.goal=[6e-17,2.0,0]",  # what a cosine gives for nothing
        "obstacles.o3={position=[0.2,1.9],velocity=[0.1,0],radius=0.3}",  # leaves the goal
        "obstacles.o3={position=[9,9],radius=0.3}",  # comes from, or stands, elsewhere
        "obstacles={}",
        "table.tilt.map=[]",
        "table.link.loss=1",
        "table.mocap.dropout_rate=1000",
        "flight.jet_period_s=0.02",
        "seed=9223372036854775807",
        "criteria={}",
        "duration_s=3600",
    ],
)
def test_values_that_look_odd_are_accepted(override):
    load(find("zhang2023_table"), [override])


# Written


@pytest.mark.parametrize("name", NAMES)
def test_round_trip(name, tmp_path):
    experiment = load(find(name), ["seed=9223372036854775807"])
    path = tmp_path / "e.toml"
    path.write_text(tomli_w.dumps(dump(experiment)), encoding="utf-8")
    assert load(path) == experiment
    assert dump(load(path)) == dump(experiment)


def test_round_trip_of_awkward_values(tmp_path):
    odd = "quote \" backslash \\ tab \t line\nbell \x07 \u00e9 \U0001f680 '''"
    experiment = hold(
        f"description={tomli_w.dumps({'d': odd}).removeprefix('d = ').strip()}",
        f"duration_s={math.pi * 10}", "controller.scale.mass=1e-300", "table.mocap.noise=5e-324",
    )  # fmt: skip
    assert experiment.description == odd
    path = tmp_path / "e.toml"
    path.write_text(tomli_w.dumps(dump(experiment)), encoding="utf-8")
    assert load(path) == experiment


def test_a_resolved_experiment_refers_to_no_other_file():
    tree = dump(load(find("hold")))
    assert isinstance(tree["table"], dict)
    assert isinstance(tree["vehicles"]["sat1"]["model"], dict)
    assert tree["seed"] == 0


def test_text_is_read_as_a_file_would_be(tmp_path):
    text = tomli_w.dumps(dump(load(find("zhang2023_table"))))
    (tmp_path / "base.toml").write_text(text, encoding="utf-8")
    overrides = ("duration_s=3", "vehicles.*.model.mass=12.5")
    assert loads(text, overrides) == load(tmp_path / "base.toml", overrides)
    with pytest.raises(ConfigError, match="the resolved experiment"):
        loads(f"{text}\n[")


def test_read_toml():
    assert read_toml(SHIPPED / "experiments" / "hold.toml")["name"] == "hold"


def test_a_file_that_is_read_twice_gives_two_trees(tmp_path):
    path = tmp_path / "some.toml"
    path.write_text("[a]\nlist = [1]\n", encoding="utf-8")
    first = read_toml(path)
    first["a"]["list"].append(2)
    assert read_toml(path) == {"a": {"list": [1]}}
    path.write_text("[a]\nlist = [3]\n", encoding="utf-8")
    assert read_toml(path) == {"a": {"list": [3]}}


def test_the_old_names_of_the_vehicles_are_links():
    for old, new in (("floater", "generic_8jet"), ("floater_15kg", "generic_8jet_15kg")):
        folder = SHIPPED / "vehicles"
        assert (folder / f"{old}.toml").samefile(folder / f"{new}.toml")
