"""Arrays on the stack are not returned, and not asked for in loops: see core/scratch.py."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = [
    path
    for package in ("testbed", "controllers", "sim_twin")
    for path in sorted((ROOT / package).rglob("*.py"))
    if "scratch(" in path.read_text() and path.name != "scratch.py"
]
LOOPS = ast.For, ast.While


def is_scratch(node: ast.AST) -> bool:
    """Whether this is a call of `scratch`."""
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") == "scratch"


def bound_to_scratch(function: ast.FunctionDef) -> set[str]:
    """Names of a function's arrays on the stack."""
    names = set()
    for one in ast.walk(function):
        if isinstance(one, ast.Assign):
            for to in one.targets:
                pairs = [(to, one.value)]
                if isinstance(to, ast.Tuple) and isinstance(one.value, ast.Tuple):
                    pairs = list(zip(to.elts, one.value.elts, strict=True))
                names |= {
                    name.id
                    for name, value in pairs
                    if isinstance(name, ast.Name) and any(map(is_scratch, ast.walk(value)))
                }
    return names


def arrays_in(value: ast.AST | None) -> Iterator[str]:
    """Names in a returned value that may be arrays: not those of which a number is taken."""
    if isinstance(value, ast.Name):
        yield value.id
    elif isinstance(value, ast.Tuple):
        for one in value.elts:
            yield from arrays_in(one)
    elif isinstance(value, ast.Subscript) and any(
        isinstance(one, ast.Slice) for one in ast.walk(value.slice)
    ):
        yield from arrays_in(value.value)


def faults_of(text: str) -> list[str]:
    """What a file does with arrays on the stack that it must not do."""
    found = []
    for function in ast.walk(ast.parse(text)):
        if not isinstance(function, ast.FunctionDef):
            continue
        names = bound_to_scratch(function)
        for one in ast.walk(function):
            if isinstance(one, ast.Return):
                gone = [name for name in arrays_in(one.value) if name in names]
                found += [f"{function.name} returns {name}" for name in gone]
            if isinstance(one, LOOPS) and any(map(is_scratch, ast.walk(one))):
                found.append(f"{function.name} asks in a loop")
        marks = [getattr(one, "id", "") for one in function.decorator_list]
        if "pasted" in marks and any(map(is_scratch, ast.walk(function))):
            found.append(f"{function.name} is pasted")
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_array_on_the_stack_leaves_its_function(path):
    assert faults_of(path.read_text()) == []


PLANTED = {
    "returns x": "def f(n):\n    x, y = scratch(n), 1.0\n    return x\n",
    "returns y": "def f(n):\n    y = scratch((n, 2))\n    return 1.0, y[:, 0]\n",
    "asks in a loop": "def f(n):\n    for k in range(n):\n        x = scratch(k)\n",
    "is pasted": "@pasted\ndef f(n):\n    x = scratch(n)\n",
}


@pytest.mark.parametrize("fault", PLANTED)
def test_each_fault_is_noticed(fault):
    assert faults_of(PLANTED[fault]) == [f"f {fault}"]
    assert faults_of("def f(n):\n    x = scratch(n)\n    return x[0], n\n") == []
