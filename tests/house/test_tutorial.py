"""The tutorial on a law of one's own does what it says."""

import json
import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from testbed.cli.main import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "your_own_law.md"
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(), re.DOTALL)
FILES = {
    code.partition("\n")[0].removeprefix("# "): code for kind, code in BLOCKS if kind == "python"
}
COMMANDS = [line for kind, code in BLOCKS if kind == "sh" for line in code.splitlines()]


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name, code in FILES.items():
        (tmp_path / name).write_text(code)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: str, *more: str) -> dict:
    words = shlex.split(command)
    assert words[:2] == ["testbed", "run"]
    result = CliRunner().invoke(main, [*words[1:], *more, "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_the_law_has_at_most_30_lines():
    assert len(FILES["my_law.py"].strip().splitlines()) - 1 <= 30  # the first names the file


@pytest.mark.slow
def test_the_law_flies_between_obstacles(here):
    metrics = run(COMMANDS[0])
    assert metrics["contacts"] == 0
    nearest = [m["min_obstacle_distance_m"] for m in metrics["vehicles"].values()]
    assert min(nearest) == pytest.approx(0.93, abs=0.02)
    assert all(m["final_error_m"] < 0.01 for m in metrics["vehicles"].values())


@pytest.mark.slow
def test_the_compiled_law_flies(here):
    metrics = run(COMMANDS[1])
    assert all(m["final_error_m"] < 0.01 for m in metrics["vehicles"].values())


def test_the_lines_for_an_experiment_file_are_understood(here):
    toml = next(code for kind, code in BLOCKS if kind == "toml")
    shipped = PAGE.parents[1] / "configs"
    text = (shipped / "experiments" / "hold.toml").read_text().replace("../", f"{shipped}/")
    before, _, after = text.partition("[controller]")
    rest = after[after.index("\n[") :]
    (here / "mine.toml").write_text(before + toml + rest)
    result = CliRunner().invoke(main, ["check", "mine.toml"])
    assert result.exit_code == 0, result.output
    assert "law python" in result.stdout


@pytest.mark.slow
def test_the_first_experiment_of_the_page_on_experiments_passes(tmp_path):
    page = PAGE.with_name("experiments.md").read_text()
    found = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert found is not None
    file = tmp_path / "my_run.toml"
    file.write_text(found[1])
    metrics = run(f"testbed run {file}", "--out", str(tmp_path / "run"))
    assert metrics["criteria"]
    assert all(metrics["criteria"].values())
