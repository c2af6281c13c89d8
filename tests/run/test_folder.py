"""A run's folder is never overwritten."""

import re
import tomllib
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import pytest

from controllers.law_file import digest
from testbed.config import dump, find, load
from testbed.run import code_digest, folder
from testbed.run.code_digest import own_version
from testbed.run.folder import FolderError, new_folder, write_config

NOON = "20260101T120000Z"


class Noon(datetime):
    """A clock that stands still."""

    @classmethod
    def now(cls, tz=None):
        return cls(2026, 1, 1, 12, tzinfo=UTC)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")


def test_default_folder_is_named_by_utc_and_experiment():
    path = new_folder(None, "hold")
    assert path.is_dir()
    assert re.fullmatch(r"runs/\d{8}T\d{6}Z_hold", str(path))


def test_runs_of_the_same_second_get_a_number(monkeypatch):
    monkeypatch.setattr(folder, "datetime", Noon)
    names = [new_folder(None, "hold").name for _ in range(3)]
    assert names == [f"{NOON}_hold", f"{NOON}_hold-2", f"{NOON}_hold-3"]
    assert new_folder(None, "other").name == f"{NOON}_other"


def test_a_file_in_the_way_of_a_default_folder(monkeypatch):
    monkeypatch.setattr(folder, "datetime", Noon)
    Path("runs").mkdir()
    Path("runs", f"{NOON}_hold").write_text("mine")
    assert new_folder(None, "hold").name == f"{NOON}_hold-2"
    assert Path("runs", f"{NOON}_hold").read_text() == "mine"


def test_runs_is_a_file():
    Path("runs").write_text("mine")
    with pytest.raises(FolderError, match="runs"):
        new_folder(None, "hold")
    assert Path("runs").read_text() == "mine"


def test_a_wanted_folder_is_made_with_its_parents():
    assert new_folder(Path("a/b/c"), "hold") == Path("a/b/c")
    assert Path("a/b/c").is_dir()


def test_an_empty_folder_is_taken():
    Path("empty").mkdir()
    assert new_folder(Path("empty"), "hold") == Path("empty")


@pytest.mark.parametrize("out", [None, Path("a/b")])
def test_a_disk_without_room_for_a_log_is_refused_and_no_folder_is_made(out, monkeypatch):
    asked = []

    def nearly_full(path):
        asked.append(path)
        return SimpleNamespace(free=1.2e6)

    monkeypatch.setattr(folder, "disk_usage", nearly_full)
    with pytest.raises(FolderError) as error:
        new_folder(out, "hold")
    assert error.value.where == str(out or "runs")
    assert error.value.expected == "at least 50 MB free on its disk"
    assert error.value.found == "1.2 MB"
    assert "--out" in error.value.hint
    assert asked == [Path.cwd()]  # of the part that exists
    assert list(Path.cwd().iterdir()) == []


@pytest.mark.parametrize("content", [".hidden", "metrics.json"])
def test_a_folder_with_anything_in_it_is_refused(content):
    Path("full").mkdir()
    Path("full", content).write_text("mine")
    with pytest.raises(FolderError, match=r"full\n  expected  a new or empty folder"):
        new_folder(Path("full"), "hold")
    assert [p.read_text() for p in Path("full").iterdir()] == ["mine"]


@pytest.mark.parametrize("out", ["file", "file/below", "dangling"])
def test_a_place_that_cannot_be_a_folder(out):
    Path("file").write_text("mine")
    Path("dangling").symlink_to("nowhere")
    with pytest.raises(FolderError):
        new_folder(Path(out), "hold")
    assert Path("file").read_text() == "mine"


def test_config_says_which_version_resolved_it_and_can_be_loaded(tmp_path):
    experiment = load(find("hold"))
    write_config(tmp_path, dump(experiment), "1.2.3")
    assert "airbearing-testbed 1.2.3" in (tmp_path / "config.toml").read_text().partition("\n")[0]
    assert load(tmp_path / "config.toml") == experiment
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["config.toml"]


def test_a_law_named_in_python_gets_its_digest(tmp_path):
    law = tmp_path / "law.py"
    law.write_text("class Mine:\n    pass\n")
    controller = {"type": "python", "law": f"{law}:Mine", "sha256": None}
    folder = tmp_path / "run"
    folder.mkdir()
    write_config(folder, {"controller": controller}, "1.2.3")
    written = tomllib.loads((folder / "config.toml").read_text())["controller"]
    assert written["law"] == "law.py:Mine"
    assert written["sha256"] == digest(law)
    with pytest.raises(FolderError, match="found     an edited one"):
        write_config(folder, {"controller": {**controller, "sha256": "0" * 64}}, "1.2.3")


def test_sources_that_are_not_installed_fly_too(monkeypatch):
    def version(name):
        raise PackageNotFoundError(name)

    assert own_version()[0].isdigit()
    monkeypatch.setattr(code_digest, "version", version)
    assert own_version() == "not-installed"
