"""`testbed console` and `testbed run --console`, without a browser."""

from pathlib import Path

import pytest

from testbed.net.flight_note import noted


@pytest.fixture
def nothing_flies(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("SUDO_UID", raising=False)


@pytest.mark.usefixtures("nothing_flies")
def test_without_a_flight_a_run_is_asked_for(testbed):
    result = testbed("console")
    assert result.exit_code == 2
    assert "a run folder, or one flight on this machine" in result.stderr
    assert "no flight" in result.stderr


@pytest.mark.usefixtures("nothing_flies")
def test_a_folder_that_is_no_run_is_refused(testbed, tmp_path):
    result = testbed("console", str(tmp_path))
    assert result.exit_code == 2
    assert str(tmp_path) in result.stderr


@pytest.mark.usefixtures("nothing_flies")
def test_the_flight_on_this_machine_is_found_by_its_note(testbed, tmp_path, monkeypatch):
    served = []
    monkeypatch.setattr("testbed.cli.console.serve", lambda *where: served.append(where))
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.toml").touch()
    with noted("", "", name="hold", folder=folder):
        assert testbed("console", "--port", "9000").exit_code == 0
    assert served == [(folder, "127.0.0.1", 9000)]


def test_the_page_of_a_run_is_served_where_it_was_asked_for(testbed, tmp_path, monkeypatch):
    opened = []

    class Page:
        def terminate(self): ...

        wait = terminate

    def page_beside(*where):
        opened.append(where)
        return Page()

    monkeypatch.setattr("testbed.cli.console.page_beside", page_beside)
    out = tmp_path / "out"
    where = ("--console", "9000", "--bind", "0.0.0.0", "--speed", "1000")
    testbed("run", "hold", "duration_s=0.5", *where, "--out", out)
    assert opened == [(out, "0.0.0.0", 9000)]


def test_a_wrong_port_is_refused_before_anything_is_written(testbed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = testbed("run", "--console", "hold")
    assert result.exit_code == 2
    assert not Path("runs").exists()
