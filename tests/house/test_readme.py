"""What README.md tells a stranger to type must work."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from firmware_interface.compiler import CompilerError, cross_compiler
from testbed.core.extra import pip_install

ROOT = Path(__file__).resolve().parents[2]


def sh_blocks(markdown: str) -> list[list[str]]:
    """Commands of each fenced sh block, without comments and with continued lines joined."""
    blocks = re.findall(r"^```sh\n(.*?)^```", markdown, re.MULTILINE | re.DOTALL)
    return [
        [shlex.join(words) for line in lines if (words := shlex.split(line, comments=True))]
        for lines in (block.replace("\\\n", " ").splitlines() for block in blocks)
    ]


TOLD = "".join(path.read_text() for path in (ROOT / "testbed").rglob("*.py"))
BLOCKS = sh_blocks((ROOT / "README.md").read_text())
COMMANDS = [shlex.split(line) for block in BLOCKS for line in block]
TESTBED = [words[1:] for words in COMMANDS if Path(words[0]).name == "testbed"]
MAKE = [words[1:] for words in COMMANDS if words[0] == "make"]


def expansion(*arguments: str) -> list[list[str]]:
    """The commands that `make` with these arguments would run."""
    env = {
        key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))
    }
    command = ["make", "--dry-run", *arguments]
    result = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return [line.split() for line in result.stdout.splitlines()]


def test_sh_blocks_are_read():
    text = "a\n```sh\nmake demo  # two words\n\ntestbed run \\\n  x\n```\n```toml\nk = 1\n```\n"
    assert sh_blocks(text) == [["make demo", "testbed run x"]]


def test_two_commands_come_first():
    assert BLOCKS[:1] == [["make demo", "make test"]]


def test_make_demo_flies_the_paper():
    assert [".venv/bin/testbed", "run", "zhang2023_table"] in expansion("demo")


def test_make_test_runs_pytest():
    assert [".venv/bin/python", "-m", "pytest"] in [words[:3] for words in expansion("test")]


def test_the_operators_packages_are_not_needed_for_tests():
    assert ".[operator]" in str(expansion("--always-make", "demo"))
    for extra in ("operator", "dashboard"):
        assert f".[{extra}]" not in str(expansion("--always-make", "test"))


def test_make_demo_installs_all_that_the_commands_of_the_readme_need():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    (operator,) = extras["operator"]
    for name in ("campaign", "dashboard", "emulator", "keys"):  # tune, --web, unicorn, lab-keys
        assert re.search(rf"\b{name}\b", operator)
        assert extras[name]


def test_the_readme_does_not_say_that_nothing_else_is_needed():
    text = (ROOT / "README.md").read_text()
    assert "nothing else" not in text
    for package in ("gcc libc6-dev", "gcc-arm-none-eabi"):
        assert package in text


def test_the_readme_lists_every_room_in_the_order_of_the_import_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    rooms = [
        room
        for line in contracts["contracts"][0]["layers"]
        for room in sorted(line.replace(".", "/").split(" | "))
    ]
    text = (ROOT / "README.md").read_text()
    (block,) = re.findall(r"^```\n(testbed/cli.*?)^```", text, re.MULTILINE | re.DOTALL)
    listed = [line.split()[0].removesuffix(".py") for line in block.splitlines()]
    assert sorted(listed) == sorted({*rooms, "configs"} - {"testbed/__main__"})
    order = [next(k for k, room in enumerate(rooms) if room == name) for name in listed[:15]]
    assert order == sorted(order)


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch):
    (code,) = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL
    )
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    assert (tmp_path / "figures" / "trajectory.svg").is_file()


def test_an_extra_is_installed_from_the_checkout(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    words = shlex.split(pip_install("campaign"))
    assert Path(words[0]).name == "pip"
    assert words[1:] == ["install", "-c", "constraints.txt", "-e", ".[campaign]"]
    monkeypatch.chdir(tmp_path)
    words = shlex.split(pip_install("campaign"))
    assert words[2:] == ["-c", f"{ROOT}/constraints.txt", "-e", f"{ROOT}[campaign]"]
    words = shlex.split(pip_install("campaign", root=tmp_path))  # of a package
    assert words[1:] == ["install", "airbearing-testbed[campaign]"]


@pytest.mark.parametrize("extra", ["campaign", "dashboard", "emulator", "export", "figures", "keys",
                                   "mocap"])  # fmt: skip
def test_every_extra_that_a_message_names_is_there(extra):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    said = f"('{extra}')" in TOLD or f'("{extra}")' in TOLD
    assert said
    assert extra in extras


@pytest.mark.parametrize("words", MAKE, ids=shlex.join)
def test_make_commands_of_the_readme_exist(words):
    expansion(*words)


def test_readme_shows_the_operator_command():
    assert any(words[:1] == ["run"] for words in TESTBED)


@pytest.mark.parametrize("words", TESTBED, ids=shlex.join)
def test_testbed_commands_of_the_readme_run(words, tmp_path):
    if "board=unicorn" in words and "CI" not in os.environ:
        try:
            cross_compiler()
        except CompilerError as error:
            pytest.skip(str(error))
    verdicts = {0}
    if words[:1] == ["run"]:
        words = [*words, "duration_s=2", "--out", str(tmp_path / "run")]
        verdicts = {0, 1}  # 2 s are too short for the criteria of an experiment
    command = [sys.executable, "-m", "testbed", *words]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode in verdicts, result.stdout + result.stderr
    assert "Traceback" not in result.stderr
