"""Runs are told apart by the code that flew them, wherever their numbers come from."""

import inspect
import shutil

import pytest

from controllers.catalogue import make_law
from firmware_interface.inproc import InprocBoard
from testbed.campaign.row import columns_of
from testbed.campaign.score import beside_metrics
from testbed.campaign.sweep import shares
from testbed.campaign.trial import fly
from testbed.faults import law_faults
from testbed.metrics.formation import formation_metrics
from testbed.metrics.run_metrics import vehicle_metrics
from testbed.rig.twin import make_twin
from testbed.run import code_digest as module
from testbed.run.fly import fly_and_judge
from testbed.run.judge import measure

DECIDE = (
    make_law, make_twin, InprocBoard, shares, columns_of, beside_metrics, fly, measure,
    formation_metrics, law_faults, vehicle_metrics, fly_and_judge,
)  # fmt: skip


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A copy of the sources, to edit."""
    for name in (*module.FOLDERS, *module.FILES):
        copy = shutil.copytree if (module.ROOT / name).is_dir() else shutil.copyfile
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        copy(module.ROOT / name, tmp_path / name)
    root = module.ROOT
    monkeypatch.setattr(module, "ROOT", tmp_path)
    return lambda thing: tmp_path / inspect.getsourcefile(thing).removeprefix(f"{root}/")


@pytest.mark.parametrize("thing", DECIDE, ids=lambda thing: thing.__name__)
def test_an_edit_of_what_decides_a_number_is_other_code(elsewhere, thing):
    before = module.code_digest.__wrapped__()
    assert before == module.code_digest.__wrapped__()
    with elsewhere(thing).open("a") as file:
        file.write("# edited")
    assert module.code_digest.__wrapped__() != before


@pytest.mark.parametrize("library", ["numpy", "numba", "scipy"])
def test_another_library_is_other_code(monkeypatch, library):
    before = module.code_digest.__wrapped__()
    found = module.version
    monkeypatch.setattr(module, "version", lambda name: "0" if name == library else found(name))
    assert module.code_digest.__wrapped__() != before


def test_an_edit_of_the_firmware_is_other_code(elsewhere):
    before = module.code_digest.__wrapped__()
    firmware = elsewhere(InprocBoard).parent / "firmware" / "core" / "abt_output.c"
    with firmware.open("a") as file:
        file.write("/* edited */")
    assert module.code_digest.__wrapped__() != before
