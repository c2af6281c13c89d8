"""Small faults for the firmware's core, one at a time: which there are, and how each is built.

Mutation testing: R. A. DeMillo, R. J. Lipton, F. G. Sayward, "Hints on test data selection", IEEE
Computer 11(4), 1978. A mutant that no test notices is either the same program written differently
or a gap in the tests.
"""

import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import tree_sitter_c
from tree_sitter import Language, Node, Parser

from firmware_interface.compiler import CORE, FIRMWARE, compiler

# abt_messages.h is generated: another test compares every byte of it with messages.toml
SOURCES = (
    *CORE,
    *sorted(set((FIRMWARE / "core").glob("*.h")) - {FIRMWARE / "core/abt_messages.h"}),
)
HOST = FIRMWARE / "host" / "inproc.c"

OTHER_OPERATOR = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"),
    "==": ("!=",), "!=": ("==",), "&&": ("||",), "||": ("&&",),
    "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",), "%": ("*",),
    "&": ("|",), "|": ("&",), "^": ("|",), "<<": (">>",), ">>": ("<<",),
    "+=": ("-=",), "-=": ("+=",), "|=": ("&=",), "^=": ("|=",), "++": ("--",), "--": ("++",),
}  # fmt: skip
NUMBER = re.compile(r"(?<![\w.])(0x[0-9a-fA-F]+|\d+)[uU]?\b")


class Mutant(NamedTuple):
    """One fault. The name says where it is without line numbers, so that it outlives edits."""

    source: Path
    begin: int  # bytes
    end: int
    text: str  # instead of what is there
    function: str
    was: str  # the line, or the statement, before and after
    now: str
    nth: int = 1  # of several with the same words in the same function

    @property
    def name(self) -> tuple[str, str, str, str, int]:
        """What identifies it."""
        return self.source.name, self.function, self.was, self.now, self.nth

    def mutated(self) -> bytes:
        """The whole file with the fault in it."""
        code = self.source.read_bytes()
        return code[: self.begin] + self.text.encode() + code[self.end :]


def one_more_and_one_less(number: str) -> Iterator[str]:
    """A literal's neighbours."""
    value = int(number.rstrip("uU"), 0)
    yield f"{value + 1}u"
    yield f"{value - 1}u" if value else "(-1)"


def instead_of(node: Node) -> Iterator[tuple[Node, str]]:
    """What may stand in the place of a node, or of a part of it."""

    def words(part: Node | None) -> str:
        return part.text.decode() if part else ""

    operator = node.child_by_field_name("operator")
    condition = node.child_by_field_name("condition")
    match node.type:
        case "binary_expression" | "assignment_expression" | "update_expression":
            for other in OTHER_OPERATOR.get(words(operator), ()):
                yield operator, other
            if words(operator) in ("&&", "||"):
                yield node, words(node.child_by_field_name("left"))
                yield node, words(node.child_by_field_name("right"))
        case "unary_expression" if words(operator) in ("!", "~", "-"):
            yield node, words(node.child_by_field_name("argument"))
        case "number_literal":
            for other in one_more_and_one_less(words(node)):
                yield node, other
        case "true" | "false":
            yield node, "true" if node.type == "false" else "false"
        case "if_statement" | "while_statement":
            yield condition, f"(!{words(condition)})"
        case "for_statement" | "conditional_expression" if condition:
            yield condition, f"!({words(condition)})"
        case "expression_statement" | "break_statement" | "continue_statement":
            yield node, ";"
        case "return_statement" if node.named_child_count == 0:
            yield node, ";"
        case "return_statement" if node.named_children[0].type != "compound_literal_expression":
            yield node.named_children[0], f"!({words(node.named_children[0])})"
            yield node.named_children[0], "0"


def function_of(node: Node | None) -> str:
    """Name of the function around a node; empty outside of all."""
    while node and node.type != "function_definition":
        node = node.parent
    while node and node.type != "identifier":
        node = node.child_by_field_name("declarator")
    return node.text.decode() if node else ""


def line_with(code: bytes, begin: int, end: int, text: str) -> tuple[str, str]:
    """The lines that a change touches, before and after, with single spaces."""
    first = code.rfind(b"\n", 0, begin) + 1
    last = code.find(b"\n", end)
    was = code[first:last].decode()
    now = code[first:begin].decode() + text + code[end:last].decode()
    return " ".join(was.split()), " ".join(now.split())


def places(source: Path) -> Iterator[tuple[int, int, str, str]]:
    """Every change of one file: where, and the text that goes there."""
    code = source.read_bytes()
    nodes = [Parser(Language(tree_sitter_c.language())).parse(code).root_node]
    while nodes:
        node = nodes.pop()
        nodes += reversed(node.children)
        for part, text in instead_of(node):
            yield part.start_byte, part.end_byte, text, function_of(node)
        if node.type == "preproc_arg":
            for found in NUMBER.finditer(node.text.decode().partition("/*")[0]):
                at = node.start_byte + found.start()
                for text in one_more_and_one_less(found[0]):
                    yield at, at + len(found[0]), text, ""


@cache
def all_mutants() -> tuple[Mutant, ...]:
    """Every fault of the core, in the order of the code."""
    found: dict[tuple[str, str, str, str, int], Mutant] = {}
    for source in SOURCES:
        code = source.read_bytes()
        for begin, end, text, function in places(source):
            was, now = line_with(code, begin, end, text)
            mutant = Mutant(source, begin, end, text, function, was, now)
            while mutant.name in found:
                mutant = mutant._replace(nth=mutant.nth + 1)
            if was != now:
                found[mutant.name] = mutant
    return tuple(found.values())


def compiled(flags: tuple[str, ...], sources: tuple[Path, ...], target: Path, first: Path) -> bool:
    """Whether it compiles; headers are looked for in `first` first."""
    core = FIRMWARE / "core"
    command = [compiler(), "-std=c99", "-w", f"-I{first}", f"-I{core}", *flags, *map(str, sources)]
    result = subprocess.run([*command, "-o", str(target)], capture_output=True, check=False)
    return result.returncode == 0


# what no C program may do ends the process, so that a test that runs into it fails
TRAPS = (
    *("-fsanitize=undefined", "-fsanitize=bounds-strict"),
    "-fsanitize-undefined-trap-on-error",
)


@cache
def unchanged(folder: Path) -> dict[str, Path]:
    """Object files of the core and its host as they are."""
    objects = {}
    for source in (*CORE, HOST):
        objects[source.name] = folder / f"{source.stem}.o"
        flags = ("-O0", "-fPIC", "-c", *TRAPS)
        assert compiled(flags, (source,), objects[source.name], source.parent), source
    return objects


def copy_with(mutant: Mutant, room: Path) -> tuple[Path, ...]:
    """All sources, with the fault, in a folder of their own: quotes find headers there first."""
    for source in (*CORE, HOST, *(FIRMWARE / "core").glob("*.h")):
        (room / source.name).write_bytes(source.read_bytes())
    (room / mutant.source.name).write_bytes(mutant.mutated())
    return tuple(room / source.name for source in (*CORE, HOST))


def library(mutant: Mutant, objects: dict[str, Path], room: Path) -> Path | None:
    """The shared library with the fault in it, in an empty folder; None if it does not compile."""
    sources = copy_with(mutant, room)
    if mutant.source.suffix == ".c":
        sources = tuple(s if s.name == mutant.source.name else objects[s.name] for s in sources)
    target = room / "mutant.so"
    flags = ("-O0", "-shared", "-fPIC", *TRAPS)
    return target if compiled(flags, sources, target, room) else None


def same_machine_code(mutant: Mutant, room: Path) -> bool:
    """Whether the compiler sees no difference: M. Papadakis et al., "Trivial compiler equivalence:
    a large scale empirical study", ICSE 2015."""

    def machine_code() -> list[bytes]:
        found = []
        for source in (room / mutant.source.name,) if mutant.source.suffix == ".c" else sources:
            compiled(("-O2", "-c"), (source,), room / "one.o", room)
            found.append((room / "one.o").read_bytes())
        return found

    sources = copy_with(mutant, room)
    with_fault = machine_code()
    (room / mutant.source.name).write_bytes(mutant.source.read_bytes())
    return machine_code() == with_fault
