"""Faults and refusals are structs: no code takes a sentence about one apart."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("testbed", "controllers", "sim_twin", "firmware_interface", "benchmarks", "examples")
CUTS = {
    "partition", "rpartition", "split", "rsplit", "startswith", "endswith",
    "removeprefix", "removesuffix", "find", "index",
}  # fmt: skip
SENTENCES = re.compile(r"faults?|reasons?|refus\w*|inhibit\w*|because|complaint|law_error")


def is_sentence(node: ast.expr) -> bool:
    """Whether an expression is the text of a fault or a refusal, by its last names."""
    names = []
    while isinstance(node, ast.Attribute | ast.Call | ast.Subscript):
        if isinstance(node, ast.Attribute):
            names.append(node.attr)
        node = node.func if isinstance(node, ast.Call) else node.value
    if isinstance(node, ast.Name):
        names.append(node.id)
    while names and names[0] in ("text", "words", "strip", "lower"):
        names.pop(0)
    return bool(names) and SENTENCES.fullmatch(names[0]) is not None


def cuts(source: str) -> list[int]:
    """Lines that take such a text apart, or look for words in it."""
    found = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Attribute(value=text, attr=verb)):
                ours = verb in CUTS and node.args and is_sentence(text)
                library = isinstance(text, ast.Name) and text.id == "re"
                if ours or (library and any(map(is_sentence, node.args))):
                    found.append(node.lineno)
            case ast.Compare(left=ast.Constant(value=str()), comparators=[text]):
                if is_sentence(text):
                    found.append(node.lineno)
            case ast.Compare(left=text, comparators=[ast.Constant(value=str(words))]):
                if words and is_sentence(text):
                    found.append(node.lineno)
    return found


@pytest.mark.parametrize(
    "line",
    [
        'row, _, text = fault.partition(": ")',
        'row = ending.fault.words.split(":")[0]',
        'metrics.fault.startswith("pose_lost")',
        'if "vehicle_silent" in ending.fault: pass',
        'if out.inhibit_reason == "not armed": pass',
        're.match("([a-z]+)", run.reason)',
        'end.fault.removeprefix("sat1: ")',
    ],
)
def test_a_planted_line_is_found(line):
    assert cuts(line) == [1]


def test_what_is_allowed():
    allowed = (
        'if fault.id == "leak": pass', 'if "leak" in names_of(fault): pass', 'text.split(":")',
        'if "leak" in table.rows: pass', 'if report.id.startswith("valve_"): pass',
    )  # fmt: skip
    assert [cuts(line) for line in allowed] == [[]] * len(allowed)


def test_no_sentence_is_taken_apart():
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line in cuts(path.read_text(encoding="utf-8"))
    ]
    assert found == []
