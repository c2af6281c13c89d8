"""The shipped papers, and what is said about one that is wrong."""

from pathlib import Path

import pytest

from testbed.config import ConfigError
from testbed.reproduction.audit import grouped, rows_of, tasks_of
from testbed.reproduction.claim import CHECK, needed
from testbed.reproduction.page import page
from testbed.reproduction.paper import chosen, complete_runs, keys, read_paper, read_papers

ROOT = Path(__file__).resolve().parents[2]
KEYS = ["gao2022", "xue2021", "xue2022", "xue2024", "zhang2023"]


@pytest.fixture(scope="module")
def papers():
    return read_papers(KEYS)


def test_all_papers_are_there():
    assert keys() == KEYS
    assert chosen("all") == KEYS
    assert chosen("xue2022") == ["xue2022"]


def test_a_paper_that_is_not_there():
    with pytest.raises(ConfigError) as error:
        chosen("xue2023")
    assert "one of: gao2022, xue2021, xue2022, xue2024, zhang2023, all" in str(error.value)
    assert "did you mean" in str(error.value)


@pytest.mark.parametrize("key", KEYS)
def test_everything_in_a_file_is_used(papers, key):
    paper = papers[key]
    wanted = {name for claim in paper.claims for name in needed(claim)}
    assert set(paper.runs) == wanted
    users = [*paper.runs.values(), *paper.claims]
    read = {name for user in users for name in user.corrections}
    assumed = {name for user in users for name in user.assumptions}
    assert set(paper.corrections) == read
    assert set(paper.assumptions) == assumed


@pytest.mark.parametrize("key", KEYS)
def test_the_docs_have_a_row_for_every_claim(papers, key):
    text = (ROOT / "docs" / "papers" / f"{key}.md").read_text()
    assert [c.id for c in papers[key].claims if f"`{key}.{c.id}`" not in text] == []
    assert [name for name in papers[key].corrections if f"**{name}**" not in text] == []


@pytest.mark.parametrize("key", KEYS)
def test_the_docs_have_the_verdict_that_is_expected(papers, key):
    lines = (ROOT / "docs" / "papers" / f"{key}.md").read_text().splitlines()
    said = {line.split("`")[1]: line for line in lines if line.startswith(f"| `{key}.")}
    wrong = [
        claim.id
        for claim in papers[key].claims
        if not said[f"{key}.{claim.id}"].endswith(
            "| input check passed |" if claim.kind == CHECK else f"| {claim.expected} |"
        )
    ]
    assert wrong == []


def test_eight_input_checks_are_no_claims(papers):
    kinds = [claim.kind for paper in papers.values() for claim in paper.claims]
    assert kinds.count(CHECK) == 8


def test_every_run_is_made_once_and_each_kind_begins_with_one(papers):
    tasks = tasks_of(papers, quick=True)
    names = [(task.paper, task.name) for task in tasks]
    assert len(names) == len(set(names)) == sum(len(paper.runs) for paper in papers.values())
    groups = grouped(tasks)
    assert sum(map(len, groups)) == len(tasks)
    assert [len(g) for g in groups] == sorted((len(g) for g in groups), reverse=True)


def test_an_interrupted_audit_judges_what_was_made(papers):
    paper = papers["xue2022"]
    made = {"disconnected": {"refused": [1.0]}}
    rows, missing = rows_of("xue2022", paper, made, quick=True)
    assert [row.id for row in rows] == ["xue2022.input.disconnected"]
    assert len(missing) == len(paper.claims) - 1
    assert "xue2022.input.disconnected" in page("xue2022", paper, rows)


def test_a_run_like_another_has_its_keys_and_its_own():
    runs = {
        "a": {"type": "t", "x": 1, "deep": {"p": 1, "q": 2}},
        "b": {"like": "a", "x": 2, "deep": {"q": 3}},
        "c": {"like": "b", "y": 4},
    }
    complete_runs(runs)
    assert runs["b"] == {"type": "t", "x": 2, "deep": {"p": 1, "q": 3}}
    assert runs["c"] == {"type": "t", "x": 2, "deep": {"p": 1, "q": 3}, "y": 4}
    assert runs["a"]["deep"] == {"p": 1, "q": 2}


@pytest.mark.parametrize(
    "runs",
    [
        {"a": {"like": "b"}},
        {"a": {"like": "a"}},
        {"a": {"like": "b"}, "b": {"like": "a"}},
        {"a": {"like": ["a"]}},
    ],
)
def test_a_run_like_nothing(runs):
    with pytest.raises(ValueError, match="circular"):
        complete_runs(runs)


GOOD = """
title = "t"
source = "s"
remark = "r"
corrections = {}
assumptions = {}
[runs.layouts]
type = "layouts"
[[claims]]
id = "x"
source = "Table 3"
claim = "c"
paper = 1.0
unit = ""
run = "layouts"
measure = "circle"
"""


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('title = "t"', 'titel = "t"', "unknown key `titel` (did you mean `title`?)"),
        ("paper = 1.0", "paper = []", "a number or a string"),
        ('type = "layouts"', 'type = "layout"', "(did you mean `layouts`?)"),
        ('id = "x"', 'id = "X y"', "claims"),
        ('run = "layouts"', 'run = "elsewhere"', "a run of layouts"),
        ('type = "layouts"', 'like = "elsewhere"', "a run to be like"),
        ('title = "t"', "title =", "a TOML file"),
    ],
)
def test_a_file_with_a_mistake(tmp_path, old, new, complaint):
    path = tmp_path / "paper.toml"
    path.write_text(GOOD)
    assert read_paper(path).claims[0].id == "x"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError) as error:
        read_paper(path)
    assert complaint in str(error.value)
    assert "paper.toml" in str(error.value)
