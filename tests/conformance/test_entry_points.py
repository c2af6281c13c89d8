"""Plug-ins by their names: found, flown, kept, refused; and nothing is looked up unasked."""

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from controllers.law_file import digest
from distribution import EXAMPLES, install
from testbed.cli.main import main
from testbed.config import ConfigError, find, load
from testbed.core import plugin

ROOT = Path(__file__).resolve().parents[2]
SHORT = ("duration_s=1", "criteria={}")
SPRINGS = 'controller={type="python", law="springs", parameters={push=0.2}}'
LAB = (EXAMPLES / "springs.py").read_text()


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def own(here, monkeypatch):
    """A package `lab` whose law is in another module than the one that offers it."""
    site = here / "site"
    (site / "lab").mkdir(parents=True)
    (site / "lab" / "__init__.py").write_text("from lab.orbit_law import Springs\n")
    (site / "lab" / "orbit_law.py").write_text(LAB)
    install(site, "lab-of-ours", {"testbed.laws": {"labs": "lab:Springs", "gone": "lab:Gone"}})
    monkeypatch.syspath_prepend(site)
    yield site / "lab" / "orbit_law.py"
    forget("lab")


def forget(package):
    for name in [n for n in sys.modules if n.partition(".")[0] == package]:
        del sys.modules[name]


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def mistake(*overrides):
    with pytest.raises(ConfigError) as raised:
        load(find("hold"), overrides)
    return raised.value


# Laws


def test_a_law_is_flown_by_its_name(installed, here):
    done = run("run", "hold", *SHORT, SPRINGS, "--out", "out")
    assert done.exit_code == 0, done.output
    config = Path("out/config.toml").read_text()
    assert 'law = "springs"' in config
    assert f'sha256 = "{digest(EXAMPLES / "springs.py")}"' in config
    assert Path("out/springs.py").read_text() == LAB  # what flew, to read
    assert run("check", "out/config.toml").exit_code == 0


def test_what_is_kept_is_the_file_that_the_law_is_written_in(own, here):
    law = 'controller={type="python", law="labs"}'
    done = run("run", "hold", *SHORT, law, "--out", "out")
    assert done.exit_code == 0, done.output
    assert Path("out/orbit_law.py").read_text() == LAB
    assert f'sha256 = "{digest(own)}"' in Path("out/config.toml").read_text()


def test_a_package_that_was_changed_is_not_the_run_that_was(own, here):
    law = 'controller={type="python", law="labs"}'
    assert run("run", "hold", *SHORT, law, "--out", "out").exit_code == 0
    own.write_text(LAB.replace("0.28", "0.29"))
    assert run("check", "out/config.toml").exit_code == 0  # this process has the old one still
    forget("lab")
    done = run("check", "out/config.toml")
    assert done.exit_code == 2
    assert re.search(r"key       controller.sha256\n", done.stderr)
    assert "orbit_law.py of its package was edited" in done.stderr


def test_an_edit_after_the_import_is_not_kept_as_what_flew(own, here):
    law = 'controller={type="python", law="labs"}'
    load(find("hold"), [law])
    own.write_text(LAB + "# edited\n")
    done = run("run", "hold", *SHORT, law, "--out", "out")
    assert done.exit_code == 2
    assert "expected  the law as it was read\n  found     an edited one" in done.stderr


def test_a_failure_in_flight_names_the_file_and_line(own, here):
    bad = "        return own.mass * a if t < 0.5 else own.weight * a"
    own.write_text(LAB.replace("        return own.mass * a", bad))
    law = 'controller={type="python", law="labs"}'
    done = run("run", "hold", *SHORT, law, "--out", "out")
    assert done.exit_code == 3, done.output
    fault = json.loads(Path("out/metrics.json").read_text())["fault"]
    line = 1 + own.read_text().splitlines().index(bad)
    assert f"orbit_law.py:{line}, in force: AttributeError" in fault


def test_an_unknown_law_and_what_may_be_meant(installed):
    error = mistake('controller={type="python", law="sprngs"}')
    assert error.key == "controller.law"
    assert error.expected.startswith('"my_law.py:Name", or one of: springs; or an entry point')
    assert error.found == '"sprngs" (did you mean `springs`?)'


def test_what_cannot_be_imported_is_said(own):
    error = mistake('controller={type="python", law="gone"}')
    assert error.found == "AttributeError: module 'lab' has no attribute 'Gone'"


def test_one_name_of_two_packages_is_refused(installed, own):
    install(own.parents[1], "another", {"testbed.laws": {"springs": "lab:Springs"}})
    error = mistake(SPRINGS)
    assert error.expected == "a name that one package publishes"
    assert error.found == '"springs" of lab:Springs, springs:Springs'


def test_parameters_are_checked(installed):
    error = mistake(SPRINGS.replace("push=0.2", "puhs=0.2"))
    assert error.key == "controller.parameters.puhs"
    assert "did you mean `push`" in error.found


# Cameras and thrusters

UDP = "table.lab.mocap.system=udp_json"
GPIO = "table.lab.thrusters={system='gpio', options={valves=[0,1,2,3,4,5,6,7], bearing=%s}}"

REFUSED = {  # overrides: (key, expected, found)
    ("table.lab.mocap.system=udp_jsn",): (
        "table.lab.mocap.system",
        "one of: natnet, zenoh, vicon, qualisys, vrpn, udp_json; or an entry point in the group"
        " testbed.mocap of a package that is installed here",
        '"udp_jsn" (did you mean `udp_json`?)',
    ),
    ("table.lab.mocap.system=natnett",): (
        "table.lab.mocap.system", "one of: natnet, ", '"natnett" (did you mean `natnet`?)',
    ),
    ("table.lab.mocap.options={port=9}",): (
        "table.lab.mocap.options", "no options: natnet is built in", "{port = ...}",
    ),
    (UDP, "table.lab.mocap.options={port=0}"): (
        "table.lab.mocap.options.port", "a whole number >= 1 and <= 65535", "0",
    ),
    (UDP, "table.lab.mocap.options={prt=9}"): (
        "table.lab.mocap.options.prt", "one of: port", "unknown key `prt` (did you mean `port`?)",
    ),
    ("table.lab.thrusters.system=serail",): (
        "table.lab.thrusters.system", "one of: serial, gpio; or", "did you mean `serial`",
    ),
    ("table.lab.thrusters.system=gpio",): (
        "table.lab.thrusters.options.valves", "a list, each entry a whole",
        "nothing: the key is missing",
    ),
    (GPIO % "99",): (
        "table.lab.thrusters.options.bearing", "a whole number >= 0 and <= 27", "99",
    ),
}  # fmt: skip


@pytest.mark.parametrize("overrides", REFUSED, ids=" ".join)
def test_what_does_not_fit_is_refused(installed, overrides):
    key, expected, found = REFUSED[overrides]
    error = mistake(*overrides)
    assert error.key == key
    assert error.expected.startswith(expected)
    assert found in error.found


def test_what_fits_is_taken(installed, here):
    experiment = load(find("hold"), [UDP, "table.lab.mocap.options={port=9870}", GPIO % 26])
    assert experiment.table.lab.mocap.options == {"port": 9870}
    done = run("run", "hold", *SHORT, UDP, GPIO % 26, "--out", "out")  # the twin needs none of them
    assert done.exit_code == 0, done.output
    assert load(Path("out/config.toml")).table.lab.thrusters.system == "gpio"


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ("def made(*pins): pass", "`\\*pins` among those of made"),
        ("def made(pin: 'Nothing'): pass", "name 'Nothing' is not defined"),
        ("made = 3", "an entry point that names a class or function"),
        ("raise OSError('no chip')", "OSError: no chip"),
    ],
)
def test_a_plug_in_that_is_none_is_refused(here, monkeypatch, made, words):
    (here / "odd.py").write_text(made + "\n")
    install(here, "odd", {"testbed.thrusters": {"odd": "odd:made"}})
    monkeypatch.syspath_prepend(here)
    try:
        error = mistake("table.lab.thrusters.system=odd")
        assert re.search(words, f"{error.expected} {error.found}")
    finally:
        forget("odd")


# What it costs


def test_nothing_is_looked_up_unless_a_name_asks_for_it(monkeypatch, installed):
    asked = []
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **words: asked.append(words))
    plugin._published.cache_clear()
    load(find("zhang2023_table"))
    assert asked == []


def test_the_checks_do_not_need_pytest_to_be_imported():
    program = (
        "import sys; sys.modules['pytest'] = None; import testbed.conformance as c; "
        "from springs import Springs; c.check_law(Springs); print('conforms')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{EXAMPLES}"},
    )  # fmt: skip
    assert done.stdout == "conforms\n"
