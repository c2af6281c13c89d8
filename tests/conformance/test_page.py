"""docs/plugins.md says what the examples do."""

import re
import shlex
import tomllib

from click.testing import CliRunner

from distribution import EXAMPLES
from testbed.cli.main import main
from testbed.config import find, load
from testbed.core import plugin

PAGE = (EXAMPLES.parents[1] / "docs" / "plugins.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
TOML = [tomllib.loads(code) for kind, code in BLOCKS if kind == "toml"]


def test_the_entry_points_are_those_of_the_package():
    project = tomllib.loads((EXAMPLES / "pyproject.toml").read_text())["project"]
    assert TOML[0]["project"]["entry-points"] == project["entry-points"]
    assert set(project["entry-points"]) == {plugin.LAWS, plugin.MOCAP, plugin.THRUSTERS}


def test_the_lines_of_the_tests_are_those_of_the_package():
    tests = (EXAMPLES / "test_plugins.py").read_text()
    tests = re.sub(r'\n    """.*"""\n', "", tests)
    shown = [code for kind, code in BLOCKS if kind == "python"]
    assert len(shown) == 3
    assert [code for code in shown if code not in tests] == []


def test_the_tables_are_what_a_table_file_takes(installed):
    for tree in TOML[1:]:
        ((name, table),) = tree["lab"].items()
        words = [f"table.lab.{name}.{key}={_toml(value)}" for key, value in table.items()]
        wire = getattr(load(find("hold"), words).table.lab, name)
        assert (wire.system, wire.options) == (table["system"], table["options"])
        assert f'system = "{wire.system}"' in PAGE


def _toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}={_toml(v)}" for k, v in value.items()) + "}"
    return f'"{value}"' if isinstance(value, str) else str(value)


def test_its_command_is_understood(installed):
    (code,) = [code for kind, code in BLOCKS if kind == "sh"]
    install, command = code.splitlines()
    assert install == "pip install -e examples/plugins"
    words = shlex.split(command)
    assert words[:2] == ["testbed", "run"]
    done = CliRunner().invoke(main, ["check", *words[2:]])
    assert done.exit_code == 0, done.output


def test_every_parameter_that_is_filled_in_is_named():
    for group, told in plugin.PROVIDED.items():
        row = next(line for line in PAGE.splitlines() if line.startswith(f"| `{group}`"))
        assert all(f"`{name}`" in row for name in told)
