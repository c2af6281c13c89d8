"""Files, commands and Python names that the documents quote in backticks exist."""

import importlib
import re
import tomllib
from collections.abc import Iterator
from functools import cache, reduce
from pathlib import Path

import click
import pytest

from testbed.cli.main import main
from testbed.config import SHIPPED
from testbed.core import plugin
from testbed.core.types import Inputs, Outputs

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
ROOMS = ("benchmarks", "configs", "controllers", "docs", "examples", "firmware_interface",
         "sim_twin", "testbed", "tests")  # fmt: skip
SUFFIXES = {".c", ".h", ".md", ".py", ".toml", ".ipynb"}
# what a run, a campaign or a lab writes, and a reader's own files in examples
NOT_OURS = {
    "access.toml", "base.toml", "campaign.toml", "config.toml", "own.toml", "sat1.toml",
    "table.toml",
    "tuned.toml", "FILE.toml", "NNNN-title.md", "fast_law.py", "my_faults.toml", "my_law.py",
    "nan_law.py",
}  # fmt: skip
FLIES = {"admit", "check", "poses", "run", "twin"}  # these take the name of an experiment
GROUPS = {plugin.LAWS, plugin.MOCAP, plugin.THRUSTERS}  # of entry points
TICK = {"inputs": Inputs, "outputs": Outputs}
QUOTED = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


@cache
def files() -> frozenset[str]:
    """Every file and folder of the project, relative to its root."""
    found = [path for room in ROOMS for path in (ROOT / room).rglob("*")]
    top = [path for path in ROOT.iterdir() if path.is_file()]
    kept = [path.relative_to(ROOT) for path in [*found, *top] if "__pycache__" not in path.parts]
    return frozenset([*map(str, kept), *ROOMS])


@cache
def names() -> frozenset[str]:
    """Every file's name without its folder."""
    return frozenset(Path(file).name for file in files())


def is_there(name: str, page: Path) -> bool:
    """Whether a file exists: from the root, beside the page, or with a unique or shared end."""
    name = name.rstrip("/")
    if (page.parent / name).exists():
        return True
    return any(file == name or file.endswith(f"/{name}") for file in files())


def looks_like_a_path(word: str) -> bool:
    """Whether a quoted word names a file or folder of this project."""
    plain = re.fullmatch(r"[A-Za-z0-9_.\-]+(/[A-Za-z0-9_.\-]+)*/?", word)
    if not plain or word.startswith(("lab/", "runs/")) or Path(word).name in NOT_OURS:
        return False
    first = word.split("/", maxsplit=1)[0]
    return Path(word).suffix in SUFFIXES or (first in ROOMS and "/" in word)


def quoted(page: Path) -> list[str]:
    """What a page has in backticks, and its fenced lines that call `testbed`."""
    text = page.read_text(encoding="utf-8")
    fenced = [line.strip() for block in FENCED.findall(text) for line in block.splitlines()] + [
        line.strip() for line in text.splitlines() if line.startswith("    ")
    ]
    return QUOTED.findall(FENCED.sub("", text)) + [
        line for line in fenced if line.startswith("testbed ")
    ]


def missing(words: list[str], page: Path) -> Iterator[str]:
    """Each quoted file, command or name that does not exist."""
    for quote in words:
        for word in re.sub(r"[,;:()\"']", " ", quote).split():
            if looks_like_a_path(word) and not is_there(word, page):
                yield word
            if re.fullmatch(r"test_\w+", word) and f"{word}.py" not in names():
                yield word
        yield from missing_of_a_command(quote)
        field = re.match(r"/\w+/tick\.(inputs|outputs)\.(\w+)", quote)
        if field and field[2] not in TICK[field[1]].__struct_fields__:
            yield quote
        dotted = re.match(
            r"(testbed|controllers|sim_twin|firmware_interface)((\.[A-Za-z_]\w*)+)", quote
        )
        if dotted and dotted[0] not in GROUPS and not is_importable(dotted[0]):
            yield dotted[0]
        target = re.match(r"make ([a-z]+)\b", quote)
        if target and f"\n{target[1]}:" not in (ROOT / "Makefile").read_text(encoding="utf-8"):
            yield f"make {target[1]}"


def missing_of_a_command(quote: str) -> Iterator[str]:
    """The verb, or the options, of a `testbed` command that do not exist."""
    found = re.match(r"(?:\S+/)?testbed ([a-z][a-z-]*)(?![\w/.])(.*)", quote)
    if not found:
        return
    verb, rest = found.groups()
    if verb not in main.commands:
        yield f"testbed {verb}"
        return
    command: click.Command = main.commands[verb]
    if isinstance(command, click.Group) and (part := re.match(r" ([a-z]+)(.*)", rest)):
        if part[1] not in command.commands:
            yield f"testbed {verb} {part[1]}"
            return
        command, rest = command.commands[part[1]], part[2]
    options = {name for option in command.params for name in option.opts}
    for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", rest.split("#")[0]):
        if option not in {*options, "--help"}:
            yield f"testbed {verb} {option}"
    named = re.match(r" ([a-z][a-z0-9_]*)(?![\w/.=-])", rest)
    if verb in FLIES and named and not (SHIPPED / "experiments" / f"{named[1]}.toml").exists():
        yield f"testbed {verb} {named[1]}"


def is_importable(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    parts = name.split(".")
    for split in range(len(parts), 0, -1):
        try:
            module = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        try:
            reduce(getattr, parts[split:], module)
        except AttributeError:
            return False
        return True
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_names_what_exists(page):
    assert sorted(set(missing(quoted(page), page))) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_a_page_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (page.parent / target).exists()] == []


def uneven(text: str) -> Iterator[str]:
    """Rows of tables that do not have as many cells as their first row."""
    for table in TABLE.findall(FENCED.sub("", text)):
        head, *rows = (line.replace("\\|", "") for line in table.splitlines())
        yield from (row for row in rows if row.count("|") != head.count("|"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_rows_of_tables_have_as_many_cells_as_their_heading(page):
    assert list(uneven(page.read_text(encoding="utf-8"))) == []


def test_an_uneven_row_is_found():
    table = "| a | b |\n|---|---|\n| `x \\| y` | 2 |\n"
    assert list(uneven(table)) == []
    assert list(uneven(f"{table}| 1 | 2 | 3 |\n")) == ["| 1 | 2 | 3 |"]


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_a_heading_lead_to_one(page):
    links = re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", page.read_text(encoding="utf-8"))
    local = [(page.parent / name if name else page, at) for name, at in links if "://" not in name]
    assert [f"{at} of {there.name}" for there, at in local if at not in anchors(there)] == []


def test_the_tables_of_the_fault_table_are_those_of_its_file():
    """Every row with its detector, response and words, and its bound in standard deviations."""
    rows = tomllib.loads((SHIPPED / "faults.toml").read_text(encoding="utf-8"))
    page = (ROOT / "docs/faults.md").read_text(encoding="utf-8")
    tables = re.findall(
        r"^\| row \| detector \| when \| response \| words \|\n\|---.*\n((?:\|.*\n)+)",
        page, re.MULTILINE,
    )  # fmt: skip
    told = [re.split(r" *\| *", line)[1:6] for table in tables for line in table.splitlines()]
    assert sorted(name.strip("`") for name, *_ in told) == sorted(rows)
    for name, detector, when, response, words in told:
        row = rows[name.strip("`")]
        also = f", else {row['otherwise']}" if "otherwise" in row else ""
        text = re.sub(r"\{[^}]*\}", "...", row["text"])
        shown = (name, detector.strip("`"), response, words)
        assert shown == (name, row["detector"], row["response"] + also, text)
        bounds = re.findall(r"([\d.]+) standard deviations", when)
        if len(bounds) == 1 and isinstance(row.get("above"), float) and "innov" not in when:
            assert (name, float(bounds[0])) == (name, row["above"])


def test_rows_that_warn_or_hold_do_not_latch_and_all_others_do():
    """As docs/faults.md and docs/safety.md say of the shipped table."""
    rows = tomllib.loads((SHIPPED / "faults.toml").read_text(encoding="utf-8"))
    passing = {name for name, row in rows.items() if row["response"] in ("warn", "hold")}
    assert passing == {name for name, row in rows.items() if not row["latched"]}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_extras_that_a_page_installs_are_declared(page):
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = pyproject["project"]["optional-dependencies"]
    asked = re.findall(r"pip install [^\n`]*?\.\[([a-z,]+)\]", page.read_text(encoding="utf-8"))
    assert [name for names in asked for name in names.split(",") if name not in extras] == []


@pytest.mark.parametrize(
    ("quote", "found"),
    [
        ("testbed/flight/nowhere.py", ["testbed/flight/nowhere.py"]),
        ("tests/nowhere", ["tests/nowhere"]),
        ("nowhere.toml", ["nowhere.toml"]),
        ("python benchmarks/nowhere.py --each 2", ["benchmarks/nowhere.py"]),
        ("testbed fly hold", ["testbed fly"]),
        ("testbed run hold --nowhere 3", ["testbed run --nowhere"]),
        ("testbed run nowhere", ["testbed run nowhere"]),
        ("testbed calibrate nowhere", ["testbed calibrate nowhere"]),
        ("testbed calibrate motion LOG --nowhere", ["testbed calibrate --nowhere"]),
        ("testbed calibrate motion LOG --vehicle own.toml", []),
        ("test_nowhere", ["test_nowhere"]),
        ("testbed.nowhere", ["testbed.nowhere"]),
        ("/sat1/tick.outputs.nowhere", ["/sat1/tick.outputs.nowhere"]),
        ("make nothing", ["make nothing"]),
        ("testbed/flight/gate.py", []),
        ("gate.py", []),
        ("testbed run hold --rig bench  # --nowhere", []),
        ("test_house", []),
        ("testbed.load", []),
        ("/sat1/tick.outputs.state.pose.x", []),
        ("testbed.core.types", []),
        ("make demo", []),
    ],
)
def test_what_does_not_exist_is_found(quote, found):
    assert list(missing([quote], ROOT / "README.md")) == found


def too_wide(text: str) -> list[str]:
    """Lines of prose with more than 120 characters; tables and code may be wider."""
    prose = FENCED.sub("", text)
    return [line for line in prose.splitlines() if len(line) > 120 and line[0] != "|"]


def test_prose_is_at_most_120_characters_wide():
    decisions = sorted((ROOT / "docs/decisions").glob("*.md"))
    made = ROOT / "docs/messages.md"  # from the definitions of the records
    pages = [ROOT / "CHANGELOG.md", *PAGES, *decisions]
    wide = {page.name: too_wide(page.read_text()) for page in pages if page != made}
    assert {name: lines for name, lines in wide.items() if lines} == {}


def test_a_wide_line_is_found():
    wide = "a word " * 20
    assert too_wide(f"short\n{wide}\n| {wide} |\n```\n{wide}\n```\n") == [wide]
