"""zhang2023's table experiment with the firmware in the loop keeps its promises, exactly twice."""

import msgspec
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from firmware_interface.compiler import CompilerError
from firmware_interface.messages import Config
from testbed.cli.main import main
from testbed.config import ConfigError, find, load
from testbed.logs.packing import unpack
from testbed.rig import firmware_boards as boards
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.fly import fly_and_judge

SATELLITES = ("sat1", "sat2", "sat3")


@pytest.fixture(scope="module", autouse=True)
def the_tools():
    """Both compilers, or a reason to skip; in CI that is a failure."""
    import os
    import shutil

    for tool in ("gcc", "arm-none-eabi-gcc"):
        if shutil.which(tool) is None:
            assert os.environ.get("CI") != "true", f"{tool} is not installed"
            pytest.skip(f"{tool} is not installed")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Metrics and edges of the whole experiment, each board once."""
    results = {}
    for board in ("inproc", "unicorn"):
        folder = tmp_path_factory.mktemp(board)
        metrics = fly_and_judge(load(find("zhang2023_table"), [f"board={board}"]), folder)
        results[board] = metrics, edges_in(folder / "log.mcap")
    return results


def edges_in(log):
    """Of each satellite: (time, mask)."""
    edges = {name: [] for name in SATELLITES}
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.topic.endswith("/valves"):
                edges[channel.topic.split("/")[1]].append(unpack("Valves", message.data).fixed)
    return edges


def fly(board, duration_s=10.0, **changes):
    overrides = [f"board={board}", f"duration_s={duration_s}"]
    overrides += [f"{key}={value}" for key, value in changes.items()]
    rig = make_twin(load(find("zhang2023_table"), overrides))
    return rig, rig.fly(NullObserver())


@pytest.mark.slow
@pytest.mark.parametrize("board", ["inproc", "unicorn"])
def test_all_criteria_are_met(flown, board):
    metrics, edges = flown[board]
    assert metrics.fault is None
    assert metrics.completed
    assert all(metrics.criteria.values())
    assert all(len(edges[name]) > 1000 for name in SATELLITES)


@pytest.mark.slow
def test_the_chip_plays_the_same_edges_to_the_microsecond(flown):
    assert flown["unicorn"][1] == flown["inproc"][1]


@pytest.mark.slow
def test_twice_the_same_edges(flown):
    rig, _ = fly("unicorn", 15.0)
    for name, first in flown["unicorn"][1].items():
        again = [(t_us * 1e-6, mask) for t_us, mask in rig.twin.plant.boards[name].edges]
        assert len(again) > 100
        assert again == first[: len(again)]


def test_it_flies_as_with_the_modelled_board():
    """The line brings plans 40 us later than the vehicle file says; nothing else differs."""
    model, driven = fly("model")[0], fly("inproc")[0]
    assert abs(driven.twin.plant.x - model.twin.plant.x)[:, :2].max() < 1e-3


def test_a_cut_line_trips_the_watchdog_and_ends_the_flight():
    rig = make_twin(load(find("zhang2023_table"), ["board=inproc"]))
    rig.boards["sat2"]._there.send = lambda t_us, data: None
    ending = rig.fly(NullObserver())
    assert ending.fault.words == "sat2: board in SAFE, faults WATCHDOG"
    assert 0.15 <= ending.t <= 0.4


def test_plans_that_the_board_refuses_end_the_flight_and_are_named(monkeypatch):
    kept = boards.limits_of

    def limits_of(vehicle):
        return msgspec.structs.replace(kept(vehicle), max_ttl_us=50_000)

    monkeypatch.setattr(boards, "limits_of", limits_of)
    rig, ending = fly("inproc")
    assert ending.t < 1.0
    assert "refused plans: TTL_TOO_LONG" in ending.fault.text
    assert all(mask == 0 for b in rig.twin.plant.boards.values() for _, mask in b.edges)


def test_without_a_compiler_the_error_names_the_way_out(monkeypatch):
    def no_board(config: Config):
        raise CompilerError("no C compiler found")

    monkeypatch.setattr(boards, "InprocBoard", no_board)
    with pytest.raises(ConfigError, match="`model` needs no tools"):
        fly("inproc")


def test_without_a_compiler_nothing_is_left_behind(monkeypatch, tmp_path):
    def no_board(config: Config):
        raise CompilerError("no C compiler found")

    monkeypatch.setattr(boards, "InprocBoard", no_board)
    words = ["run", "hold", "board=inproc", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert "no C compiler found" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_jet_period_that_the_firmware_does_not_play_is_refused_by_the_file():
    overrides = ["flight.jet_period_s=1.5"]
    load(find("hold"), overrides)
    with pytest.raises(ConfigError, match="the longest plan of the firmware"):
        load(find("hold"), [*overrides, "board=inproc"])


def test_a_vehicle_with_more_jets_than_the_board_has_outputs_is_refused_by_the_file(tmp_path):
    jets = load(find("hold")).vehicles
    name = next(iter(jets))
    many = msgspec.to_builtins([*jets[name].model.jets, jets[name].model.jets[0]])
    inline = "[" + ", ".join(
        f"{{position={list(j['position'])}, push={list(j['push'])}, thrust={j['thrust']}}}"
        for j in many
    ) + "]"  # fmt: skip
    override = f"vehicles.{name}.model.jets={inline}"
    load(find("hold"), [override])
    with pytest.raises(ConfigError, match="the board drives 1 to 8"):
        load(find("hold"), [override, "board=unicorn"])
