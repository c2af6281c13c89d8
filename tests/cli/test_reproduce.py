"""`testbed reproduce`: what it prints, its exit codes, and what is left after Ctrl-C.

Most of it on a small paper made here, whose runs take no time; one of the shipped ones whole.
"""

import json

import pytest

from testbed.cli import reproduce as command
from testbed.reproduction import audit
from testbed.reproduction import paper as papers
from testbed.reproduction.audit import make

SMALL = """
title = "even formations"
source = "A. Nobody, Journal of Nothing, 2020."
remark = "A remark."

[corrections.ring]
at = "Eq. (28)"
printed = "N + 2 pi"
read = "N + pi"
why = "It is so."

[assumptions.even]
what = "even means even"
why = "Not defined."

[runs.layouts]
assumptions = ["even"]
type = "refusal"
names = ["1", "2"]
says = "not connected"

[runs.layouts.controller]
type = "connectivity_static"
formation = { range = 120.0, safe = 10.0, edges = [], distances = { 1-2 = 60.0 } }

[runs.twenty]
like = "layouts"
assumptions = []

[[claims]]
id = "ring"
source = "Table 3"
claim = "L of a ring of 50"
paper = 1.0
unit = ""
tolerance = 0.0001
run = "layouts"
measure = "refused"
corrections = ["ring"]
expected = "holds with a correction"

[[claims]]
id = "ring.twenty"
source = "Table 3"
claim = "L of a ring of 20"
paper = 0.5
unit = ""
tolerance = 0.0001
run = "twenty"
measure = "refused"
expected = "fails"

[[claims]]
id = "metal"
source = "Fig. 1"
claim = "it flew"
paper = "a photograph"
unit = ""
untestable = "there is no data"
expected = "cannot be tested"
"""

TWO = """
orbit = { a_km = 7000.0, e = 0.0 }
mass = [1.0, 1.0]
start = [[0.0, 0.0, 0.0], [60.0, 0.0, 0.0]]
duration_s = 1.0
step_s = 0.1
quick_step_s = 0.1
"""


@pytest.fixture
def small(tmp_path, monkeypatch):
    """Only this paper, in files that a test may change."""
    folder = tmp_path / "papers"
    folder.mkdir()
    path = folder / "small.toml"
    path.write_text(SMALL)
    monkeypatch.setattr(papers, "PAPERS", folder)
    monkeypatch.setattr(audit, "CORES", 1)  # other processes do not know of this
    return path


def test_json_is_one_object_per_paper(testbed, small):
    result = testbed("reproduce", "small", "--json", "--quick")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["paper"] == "small"
    assert found["counts"]["claims"] == {
        "holds": 0, "holds with a correction": 1, "fails": 1, "cannot be tested": 1,
    }  # fmt: skip
    assert found["counts"]["input_checks"] == {"passed": 0, "failed": 0}
    ring, twenty, metal = found["claims"]
    assert list(ring)[:8] == [
        "id", "source", "claim", "paper", "measured", "unit", "verdict", "assumption",
    ]  # fmt: skip
    assert ring["id"] == "small.ring"
    assert ring["measured"] == 1.0
    assert ring["verdict"].startswith("reproduced with assumption: Eq. (28) read as N + pi; even")
    assert twenty["verdict"].startswith("not reproducible: measured 1")
    assert metal["verdict"] == "not reproducible: there is no data"
    assert metal["measured"] is None
    assert all(claim["as_expected"] and claim["quick"] for claim in found["claims"])


def test_all_is_a_list(testbed, small):
    small.with_name("tiny.toml").write_text(SMALL)
    found = json.loads(testbed("reproduce", "all", "--json").stdout)
    assert [one["paper"] for one in found] == ["small", "tiny"]


def test_a_second_run_says_the_same(testbed, small):
    one, two = (testbed("reproduce", "small", "--json").stdout for _ in range(2))
    assert one == two


def test_the_table_is_for_people(testbed, small):
    result = testbed("reproduce", "small")
    assert result.exit_code == 0
    counted = "3 claims: 0 holds, 1 holds with a correction, 1 fails, 1 cannot be tested (in"
    for words in ("even formations", "0.5", counted):
        assert words in result.output
    assert "\x1b" not in result.output


def test_a_verdict_that_has_changed_is_told_and_1(testbed, small):
    small.write_text(SMALL.replace('expected = "fails"', 'expected = "holds"'))
    result = testbed("reproduce", "small", "--json")
    assert result.exit_code == 1
    assert 'changed: small.ring.twenty: expected "holds", found "fails"' in result.stderr


def test_markdown_is_the_page(testbed, small):
    result = testbed("reproduce", "small", "--markdown")
    assert result.exit_code == 0
    assert result.stdout.startswith("# small: even formations\n")
    assert "| `small.ring` | Table 3 |" in result.stdout
    assert "* **ring**, Eq. (28): printed N + 2 pi; read as N + pi. It is so." in result.stdout


def test_input_checks_are_counted_and_printed_apart(testbed, small):
    small.write_text(
        SMALL.replace('id = "ring"\n', 'id = "ring"\nkind = "input check"\n').replace(
            'expected = "holds with a correction"', 'expected = "holds"'
        )
    )
    result = testbed("reproduce", "small", "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["counts"]["input_checks"] == {"passed": 1, "failed": 0}
    assert sum(found["counts"]["claims"].values()) == 2
    assert found["claims"][0]["kind"] == "input check"
    assert found["claims"][0]["verdict"] == "input check passed"
    assert "2 claims: " in result.stderr
    assert "; 1 input checks, all passed" in result.stderr
    page = testbed("reproduce", "small", "--markdown").stdout
    claims, _, checks = page.partition("## Input checks")
    assert "`small.ring`" not in claims
    assert "| `small.ring` | Table 3 | L of a ring of 50 | input check passed |" in checks


def test_plots_are_files(testbed, small, tmp_path):
    folder = tmp_path / "plots"
    assert testbed("reproduce", "small", "--json", "--plots", folder).exit_code == 0
    assert folder.is_dir()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("reproduce", "smal"), "one of: small, all"),
        (("reproduce", "smal"), "did you mean `small`?"),
        (("reproduce",), "Missing argument 'KEY'"),
        (("reproduce", "small", "--plots", "/dev/null/x"), "--plots"),
    ],
)
def test_2_when_the_command_is_wrong(testbed, small, words, complaint):
    result = testbed(*words)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert complaint in result.stderr


def test_2_when_a_claim_needs_a_number_that_is_not_measured(testbed, small):
    small.write_text(SMALL.replace('measure = "refused"', 'measure = "refuse"'))
    result = testbed("reproduce", "small")
    assert result.exit_code == 2
    assert "expected a measure of run layouts" in result.stderr


def test_2_when_a_run_cannot_be_made(testbed, small):
    text = SMALL.replace('type = "refusal"', 'type = "together"').replace('names = ["1", "2"]', TWO)
    small.write_text(text.replace('says = "not connected"', ""))
    result = testbed("reproduce", "small")
    assert result.exit_code == 2
    assert "error: run layouts of small: the initial graph is not connected" in result.stderr


def test_130_and_the_rows_so_far_when_interrupted(testbed, small, monkeypatch):
    def one_and_then(tasks):
        yield make(tasks[0])
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "made", one_and_then)
    result = testbed("reproduce", "small", "--json")
    assert result.exit_code == 130
    ids = [claim["id"] for claim in json.loads(result.stdout)["claims"]]
    assert ids == ["small.ring", "small.metal"]
    assert "interrupted: 1 claims were not reached: small.ring.twenty" in result.stderr


@pytest.mark.slow
def test_a_shipped_paper_has_the_verdicts_that_its_file_expects(testbed):
    result = testbed("reproduce", "xue2022", "--quick", "--json")
    assert result.exit_code == 0, result.stderr
    claims = json.loads(result.stdout)["claims"]
    assert len(claims) > 20
