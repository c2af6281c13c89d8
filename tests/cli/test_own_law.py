"""A law in a file of the user's own, from the command line: flown, kept, noticed, blamed."""

import json
import re
from pathlib import Path

import pytest
import tomli_w

from controllers.law_file import maker
from testbed.campaign.trial import fly
from testbed.config import dump, find, load

pytestmark = pytest.mark.usefixtures("here")

SPRING = """
import numpy as np
from msgspec import Struct


class Spring(Struct, frozen=True):
    stiffness: float = 0.04
    damping: float = 0.4
    step_s: float = 0.02

    def force(self, own, neighbours, world, t):
        a = self.stiffness * (world.goal.p - own.p) - self.damping * own.v
        return {factor} * own.mass * a
"""
SHORT = ("duration_s=2", "criteria={}")
LAW = 'controller={type="python", law="law_of_mine.py:Spring"}'


@pytest.fixture
def mine(here):
    file = here / "law_of_mine.py"
    file.write_text(SPRING.format(factor=1.0))
    return file


def final_error(folder: str) -> float:
    metrics = json.loads((Path(folder) / "metrics.json").read_text())
    return metrics["vehicles"]["sat1"]["final_error_m"]


def refusal(result) -> tuple[str, str, str]:
    """Key, expected, found."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    form = r"error: .*\n  key       (.*)\n  expected  (.*)\n  found     (.*)\n(?:  hint      .*\n)?"
    match = re.fullmatch(form, result.stderr)
    assert match, result.stderr
    return match[1], match[2], match[3]


# Flown


def test_it_flies_in_every_process_and_the_folder_repeats_the_run(testbed, start, mine):
    process = start("run", "hold", *SHORT, LAW, "--out", "one")
    _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert testbed("run", "hold", *SHORT, LAW, "--out", "two").exit_code == 0
    mine.unlink()  # the folder has a copy
    assert testbed("run", "one/config.toml", "--out", "three").exit_code == 0
    assert final_error("one") == final_error("two") == final_error("three")
    assert Path("one/law_of_mine.py").read_text() == SPRING.format(factor=1.0)


def test_an_edit_is_noticed(testbed, mine):
    testbed("run", "hold", *SHORT, LAW, "--out", "before")
    mine.write_text(SPRING.format(factor=0.0))
    testbed("run", "hold", *SHORT, LAW, "--out", "after")
    assert abs(final_error("before") - final_error("after")) > 1e-4
    hashes = [
        re.search(r'sha256 = "(\w{64})"', Path(name, "config.toml").read_text())[1]
        for name in ("before", "after")
    ]
    assert hashes[0] != hashes[1]


def test_an_edited_copy_is_not_the_run_that_was(testbed, mine):
    testbed("run", "hold", *SHORT, LAW, "--out", "out")
    Path("out/law_of_mine.py").write_text(SPRING.format(factor=2.0))
    key, expected, found = refusal(testbed("check", "out/config.toml"))
    assert key == "controller.sha256"
    assert "remove the key to accept any content" in expected
    assert found.endswith("law_of_mine.py was edited")


REMEMBERS = """
import numpy as np

rng = np.random.default_rng(1)
asked = 0


class Remembers:
    step_s = 0.02
    met = []

    def force(self, own, neighbours, world, t):
        global asked
        asked += 1
        self.met.append(t)
        return 1e-3 * rng.standard_normal(2) + 1e-5 * asked + 1e-5 * len(self.met)
"""


def test_what_a_law_keeps_in_its_module_is_of_one_run_and_one_vehicle(here):
    (here / "law.py").write_text(REMEMBERS)
    law = "controller={type='python',law='law.py:Remembers'}"
    base = tomli_w.dumps(dump(load(find("hold"), ["duration_s=1", "criteria={}", law])))
    first = fly(base, 0, ())
    fly(base, 1, ("duration_s=2", "seed=7"))
    again = fly(base, 0, ())
    assert first.outcome == again.outcome == "passed"
    assert first.columns == again.columns
    one, two = maker("law.py:Remembers"), maker("law.py:Remembers")  # of two vehicles
    assert one.force.__globals__["rng"] is not two.force.__globals__["rng"]


COMPILED = """
import numba
from testbed.core.law import bounded


class Mine:
    def force(self, own, neighbours, world, t):
        return bounded(-own.v, 1.0)
"""


@pytest.mark.parametrize(
    "more",
    [
        "@numba.njit\ndef twice(x):\n    return 2 * x",
        "class Sums:\n    @staticmethod\n    @numba.njit\n    def twice(x):\n        return 2 * x",
        "from testbed.core.law import compiled_rate\nclass Gains(tuple): ...\n"
        "@compiled_rate(Gains)\ndef rate(gains, law_state, own, neighbours, world, t): ...",
    ],
)
def test_a_file_with_machine_code_is_not_compiled_anew_for_each_run(here, more):
    file = here / "law.py"
    file.write_text(COMPILED)  # it only uses what is compiled already
    assert maker("law.py:Mine") is not maker("law.py:Mine")
    file.write_text(f"{COMPILED}\n\n{more}\n")
    assert maker("law.py:Mine") is maker("law.py:Mine")


def test_a_parameter_on_the_command_line(testbed, mine):
    testbed("run", "hold", *SHORT, LAW, "--out", "soft")
    testbed("run", "hold", *SHORT, LAW, "controller.parameters.stiffness=0.4", "--out", "stiff")
    assert final_error("stiff") < final_error("soft")


def test_it_is_listed(testbed):
    assert "python" in json.loads(testbed("list", "--json").stdout)["laws"]


def test_a_package_may_publish_laws(testbed, here, monkeypatch):
    (here / "orbital_labs.py").write_text(SPRING.format(factor=1.0))
    about = here / "orbital_labs-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: orbital-labs\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[testbed.laws]\nlabs-spring = orbital_labs:Spring\nlabs-broken = orbital_labs:Nothing\n"
    )
    monkeypatch.syspath_prepend(here)
    named = 'controller={type="python", law="labs-%s"}'
    assert testbed("run", "hold", *SHORT, named % "spring", "--out", "out").exit_code == 0
    assert testbed("check", "out/config.toml").exit_code == 0
    key, expected, _ = refusal(testbed("check", "hold", named % "sprung"))
    assert (key, "labs-broken, labs-spring" in expected) == ("controller.law", True)
    found = refusal(testbed("check", "hold", named % "broken"))[2]
    assert found == "AttributeError: module 'orbital_labs' has no attribute 'Nothing'"


# Bad input

NAMED = "my_law.py:Law"
PARAMETERS = "class Law:\n    def __init__(self, gain: float, axes: tuple[int, int] = (0, 1)):\n"
FORCE = "    def force(self, own, neighbours, world, t):\n"
COMPILED_LAW = (
    "from typing import NamedTuple\nimport numpy as np\n"
    "from testbed.core.law import CompiledLaw, compiled_jump, compiled_rate, no_state\n"
    "class Gains(NamedTuple):\n    k: float\n"
    "@compiled_rate(Gains)\n"
    "def rate(gains, law_state, own, neighbours, world, t):\n    return {says}\n"
    "def Law():\n    return CompiledLaw(Gains(1.0), no_state, rate)\n"
)
BAD = {  # name: (content of my_law.py, [controller] law, parameters, key, expected, found)
    "no file": (None, NAMED, "{}", "law", "the path of a Python file and a name", "No such file"),
    "no colon": ("", "my_law.py", "{}", "law", "entry point", '"my_law.py"'),
    "no name": (
        "class Mine:\n    pass\n", NAMED, "{}", "law", "a class or function of my_law.py: Mine",
        "`Law`",
    ),
    "an empty file": ("", NAMED, "{}", "law", "it defines none", "`Law`"),
    "no law": ("Law = 3\n", NAMED, "{}", "law", "class or function", "`Law`, which is neither"),
    "syntax": ("x = 1\nclass Law\n", NAMED, "{}", "law", "can be executed", "my_law.py:2: Synt"),
    "import": (
        "import nothing_of_the_kind\n", NAMED, "{}", "law", "can be executed",
        "my_law.py:1, in <module>: ModuleNotFoundError: No module named 'nothing_of_the_kind'",
    ),
    "no verb": (
        "class Law:\n    pass\n", NAMED, "{}", "law", "force(own, neighbours, world, t)",
        "Law with neither",
    ),
    "signature": (
        "class Law:\n    def force(self, own, t):\n        return own.p\n", NAMED, "{}", "law",
        "force(own, neighbours, world, t)", "my_law.py: force(own, t)",
    ),
    "parameters without names": (
        "class Law:\n    def __init__(self, *gains):\n        pass\n", NAMED, "{}", "law",
        "parameters that all have names", "`*gains` among those of Law",
    ),
    "missing parameter": (
        PARAMETERS + "        pass\n", NAMED, "{}", "parameters.gain", "a number",
        "the key is missing",
    ),
    "wrong parameter": (
        PARAMETERS + "        pass\n", NAMED, "{gain='x'}", "parameters.gain", "a number", '"x"',
    ),
    "deeper": (
        PARAMETERS + "        pass\n", NAMED, "{gain=1.0,axes=[0,0.5]}", "parameters.axes.2",
        "a whole number", "0.5",
    ),
    "unknown parameter": (
        PARAMETERS + "        pass\n", NAMED, "{gain=1,gian=2}", "parameters.gian",
        "one of: axes, gain", "did you mean `gain`",
    ),
    "refused parameter": (
        PARAMETERS + "        if gain < 0:\n            raise ValueError('gain < 0')\n", NAMED,
        "{gain=-1}", "parameters", "values it accepts",
        "my_law.py:4, in __init__: ValueError: gain < 0",
    ),
    "shape": (
        "class Law:\n" + FORCE + "        return 1.0\n", NAMED, "{}", "law",
        "a force [N]: finite real numbers of shape (2,)",
        "my_law.py:2, in force at 0 s: shape (), 1.0",
    ),
    "exception": (
        "class Law:\n" + FORCE + "        return own.p / own.q\n", NAMED, "{}", "law",
        "a law that says what to do", "my_law.py:3, in force: AttributeError: 'Body' object has",
    ),
    "writes": (
        "class Law:\n" + FORCE + "        e = own.p\n        e -= world.goal.p\n        return e\n",
        NAMED, "{}", "law", "a law that says what to do",
        "my_law.py:4, in force: ValueError: output array is read-only",
    ),
    "step in words": (
        "class Law:\n    step_s = 'fast'\n" + FORCE + "        return 0.0 * own.p\n", NAMED, "{}",
        "law", "step_s: a time in seconds", "my_law.py: step_s = 'fast'",
    ),
    "step of nothing": (
        "class Law:\n    step_s = None\n" + FORCE + "        return 0.0 * own.p\n", NAMED, "{}",
        "law", "step_s: a time in seconds", "my_law.py: step_s = None",
    ),
    "negative step": (
        "class Law:\n    step_s = -0.1\n" + FORCE + "        return 0.0 * own.p\n", NAMED, "{}",
        "law", "step_s: a time in seconds", "my_law.py: step_s = -0.1",
    ),
    "step that is no number": (
        "class Law:\n    step_s = float('nan')\n" + FORCE + "        return 0.0 * own.p\n", NAMED,
        "{}", "law", "step_s: a time in seconds", "my_law.py: step_s = nan",
    ),
    "message size": (
        "class Law:\n    message_size = 'two'\n" + FORCE + "        return 0.0 * own.p\n", NAMED,
        "{}", "law", "message_size: a whole number", "my_law.py: message_size = 'two'",
    ),
    "a bare force": (
        "def force(own, neighbours, world, t):\n    return 0.0 * own.p\n", "my_law.py:force", "{}",
        "law", "a class, or a function that returns a law",
        "`force` takes own, neighbours, world, t like a law's own method",
    ),
    "message size without a message": (
        "class Law:\n    message_size = 2\n" + FORCE + "        return 0.0 * own.p\n", NAMED,
        "{}", "law", "a method broadcast(law_state, own, ", "message_size = 2 and none",
    ),
    "compiled with a wrong shape": (
        COMPILED_LAW.format(says="own.p[:1], np.zeros(0)"), NAMED, "{}", "law",
        "a force [N]: finite real numbers of shape (2,)", "my_law.py, in rate at 0 s: shape (1,)",
    ),
    "compiled with a wrong rate": (
        COMPILED_LAW.format(says="0.0 * own.p, np.zeros(3)"), NAMED, "{}", "law",
        "the rate of the law's state: finite real numbers of shape (0,)",
        "my_law.py, in rate at 0 s: shape (3,)",
    ),
    "compiled with a wrong jump": (
        COMPILED_LAW.format(says="0.0 * own.p, np.zeros(0)")
        + "@compiled_jump(Gains)\n"
        "def jump(gains, law_state, own, neighbours, world, t):\n    return np.zeros(1)\n", NAMED,
        "{}", "law", "the law's state after the jump: finite real numbers of shape (0,)",
        "my_law.py, in jump: shape (1,)",
    ),
    "compiled": (
        COMPILED_LAW.format(says="gains.k * own.q, np.empty(0)"),
        NAMED, "{}", "law", "a law that says what to do", "my_law.py:8: TypingError: Unknown attr",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_laws_are_refused(testbed, here, name):
    content, law, parameters, key, expected, found = BAD[name]
    if content is not None:
        (here / "my_law.py").write_text(content)
    setting = f'controller={{type="python", law="{law}", parameters={parameters}}}'
    message = refusal(testbed("run", "hold", setting))
    assert message[0] == f"controller.{key}"
    assert expected in message[1]
    assert found in message[2]
    assert not Path("runs").exists()


def test_a_mistake_elsewhere_is_not_blamed_on_the_parameters(testbed, mine):
    mistake = "controller={type='python',law='law_of_mine.py:Spring',parameters={stiffness=1}}"
    key, _, found = refusal(testbed("check", "hold", mistake, "guidance.mode=wrnch"))
    assert (key, found) == ("guidance.mode", '"wrnch" (did you mean `wrench`?)')


# Failures in flight


def test_a_law_that_gives_nan_at_once_is_refused_before_a_flight(testbed, here):
    (here / "nan.py").write_text(
        "class Law:\n    def force(self, own, neighbours, world, t):\n"
        "        return float('nan') * own.p\n"
    )
    for verb in ("check", "run"):
        result = testbed(verb, "hold", 'controller={type="python", law="nan.py:Law"}')
        assert result.exit_code == 2
        assert "nan.py:2, in force at 0 s: array([nan, nan])" in result.stderr
        assert "hint      look for a division by zero" in result.stderr


LATE = """
class Law:
    def force(self, own, neighbours, world, t):
        if t > 1.0:
            {what}
        return 0.0 * own.p
"""


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("1.0 / 0.0", "my_law.py:5, in force: ZeroDivisionError: "),
        ("return float('nan') * own.p", "my_law.py:3, in force at 1.0"),
        ("return None", "my_law.py:3, in force at 1.0"),
    ],
)
def test_a_law_that_fails_in_flight_ends_the_run_as_a_fault(testbed, here, what, reason):
    (here / "my_law.py").write_text(LATE.format(what=what))
    setting = f'controller={{type="python", law="{NAMED}"}}'
    result = testbed("run", "hold", *SHORT, setting, "--out", "out")
    assert result.exit_code == 3
    assert "aborted after" in result.stdout
    metrics = json.loads(Path("out/metrics.json").read_text())
    assert f"law on the host: LawError: {reason}" in metrics["fault"]
    assert metrics["completed"] is False
    assert 0.3 < metrics["duration_s"] < 1.0  # references are sent ahead


def test_a_law_that_fails_is_replayed_to_the_last_bit_and_named_in_the_report(testbed, here):
    (here / "sick.py").write_text(
        "import math\n\nimport numpy as np\n\n\nclass Sick:\n"
        "    def force(self, own, neighbours, world, t):\n"
        "        return np.array([math.nan if t > 0.7 else 0.0, 0.0])\n"
    )
    sick = 'controller={type="python", law="sick.py:Sick"}'
    assert testbed("run", "hold", "duration_s=2", sick, "--out", "out").exit_code == 3
    found = json.loads(testbed("replay", "out", "--json").stdout)
    assert found["first_difference"] is None
    page = Path("out/report.html").read_text()
    assert "Law <b>sick.py:Sick</b>" in page
    assert "sick.py:7, in force at 0.7" in page


# The bound of its force

GREEDY = """
class Law:
    step_s = 0.1

    def force(self, own, neighbours, world, t):
        return {gain} * (world.goal.p - own.p)
"""


@pytest.mark.parametrize("mode", ["reference", "wrench"])
def test_a_law_that_asks_for_too_much_flies_with_what_the_jets_give(testbed, here, mode):
    (here / "my_law.py").write_text(GREEDY.format(gain=1e9))
    setting = f'controller={{type="python", law="{NAMED}"}}'
    result = testbed("run", "hold", *SHORT, f'guidance.mode="{mode}"', setting, "--out", "out")
    assert result.exit_code == 0, result.output
    metrics = json.loads(Path("out/metrics.json").read_text())
    assert metrics["vehicles"]["sat1"]["max_force_n"] < 1.3


@pytest.mark.parametrize(
    ("gain", "time", "warned"),
    [(1e4, 1.0, True), (1e-3, 1.0, False), (1e-3, 1e4, True)],
)
def test_check_warns_of_a_law_that_asks_for_too_much_at_the_start(
    testbed, here, gain, time, warned
):
    (here / "my_law.py").write_text(GREEDY.format(gain=gain))
    setting = f'controller={{type="python", law="{NAMED}", scale={{time={time}}}}}'
    result = testbed("check", "hold", setting)
    assert result.exit_code == 0
    assert ("demand-beyond-thrust: at the start the law asks sat1" in result.stderr) == warned


def test_check_warns_of_a_compiled_law_that_limits_nothing(testbed, here):
    (here / "my_law.py").write_text(
        "from typing import NamedTuple\nimport numpy as np\n"
        "from testbed.core.law import CompiledLaw, compiled_rate, no_state\n"
        "class Gains(NamedTuple):\n    k: float\n"
        "@compiled_rate(Gains)\n"
        "def rate(gains, law_state, own, neighbours, world, t):\n"
        "    return gains.k * (world.goal.p - own.p), np.empty(0)\n"
        "def Law():\n    return CompiledLaw(Gains(1e4), no_state, rate)\n"
    )
    result = testbed("check", "hold", f'controller={{type="python", law="{NAMED}"}}')
    assert result.exit_code == 0
    assert "a compiled law must limit its own" in result.stderr


# Heard


def test_what_it_prints_is_not_the_result(testbed, here):
    loud = SPRING.format(factor=1.0).replace("        a = ", "        print('here')\n        a = ")
    (here / "law_of_mine.py").write_text("print('read')\n" + loud)
    for verb in (("run", "hold", *SHORT, LAW, "--out", "loud"), ("replay", "loud")):
        result = testbed(*verb, "--json")
        assert result.exit_code == 0, result.output
        json.loads(result.stdout)
        assert "here" in result.stderr
