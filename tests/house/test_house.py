"""Rules of the house that a machine can check: CONTRIBUTING.md says what they are for."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from testbed.core import code_cache

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("testbed", "controllers", "sim_twin", "firmware_interface")
LAWS = (
    "sotsmc.py", "smc.py", "potential.py", "bifurcating.py", "bounded_formation.py",
    "bounded_leader.py", "bounded_leader_varying.py", "connectivity_static.py",
    "connectivity_dynamic.py", "collision_sliding.py",
)  # fmt: skip
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


# Imports


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts in `folder`'s pyproject.toml against the packages there."""
    return subprocess.run(
        [
            *(sys.executable, "-c"),
            "from importlinter.cli import lint_imports_command as main; main()",
            *("--no-cache", "--no-logo"),
        ],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_imports_point_down():
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("module", "imported"),
    [
        ("controllers/potential.py", "testbed.rig.twin"),
        ("controllers/potential.py", "sim_twin"),
        ("testbed/flight/tracker.py", "controllers.potential"),
        ("testbed/core/types.py", "time"),
    ],
)
def test_a_wrong_import_is_found(tmp_path, module, imported):
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with (tmp_path / module).open("a") as file:
        file.write(f"\nimport {imported}\n")

    result = lint_imports(tmp_path)

    importer = module.removesuffix(".py").replace("/", ".")
    assert result.returncode == 1, result.stdout + result.stderr
    assert f"{importer} -> {imported}" in result.stdout


# Modules


def test_there_are_modules():
    assert {name_of(path).split("/")[0] for path in MODULES} == set(PACKAGES)


def test_no_module_is_longer_than_400_lines():
    lengths = {name_of(path): len(path.read_text().splitlines()) for path in MODULES}
    assert {name: lines for name, lines in lengths.items() if lines > 400} == {}


def test_what_is_compiled_is_kept_on_disk():
    """Elsewhere it would be compiled anew by every process."""
    marked = [p for p in MODULES if re.search(r"^@(compiled|inlined)", p.read_text(), re.M)]
    assert len(marked) > 20
    kept = tuple(f"{package}/" for package in code_cache.PACKAGES)
    assert [name_of(p) for p in marked if not name_of(p).startswith(kept)] == []


def test_every_module_says_what_it_is():
    assert [name_of(p) for p in MODULES if not ast.get_docstring(ast.parse(p.read_text()))] == []


def test_no_module_has_a_name_that_says_nothing():
    empty = {"utils", "util", "helpers", "helper", "common", "manager", "base"}
    assert [name_of(p) for p in MODULES if {p.stem, p.parent.name} & empty] == []


def hidden_randomness(source: str) -> list[str]:
    """Uses of random numbers that no caller seeded."""
    handed_over = {"Generator", "BitGenerator", "PCG64", "Philox", "SeedSequence", "default_rng"}
    found = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=names):
                found += [a.name for a in names if a.name == "random"]
            case ast.ImportFrom(module="random"):
                found.append("random")
            case ast.ImportFrom(module="numpy.random", names=names):
                found += [f"numpy.random.{a.name}" for a in names if a.name not in handed_over]
            case ast.Attribute(value=value, attr=attr) if attr not in handed_over:
                if ast.unparse(value) in {"np.random", "numpy.random"}:
                    found.append(f"numpy.random.{attr}")
            case ast.Call(func=func, args=[], keywords=[]):
                if ast.unparse(func).split(".")[-1] in {"default_rng", "SeedSequence"}:
                    found.append("a generator without a seed")
    return found


@pytest.mark.parametrize(
    "source",
    [
        "import random",
        "from random import gauss",
        "from numpy.random import rand",
        "x = np.random.rand(3)",
        "numpy.random.seed(1)",
        "rng = np.random.default_rng()",
    ],
)
def test_hidden_randomness_is_found(source):
    assert hidden_randomness(source)


@pytest.mark.parametrize("source", ["rng = np.random.default_rng(seed)", "rng.random(3)"])
def test_seeded_randomness_is_fine(source):
    assert hidden_randomness(source) == []


def test_all_randomness_is_seeded():
    found = {name_of(path): hidden_randomness(path.read_text()) for path in MODULES}
    assert {name: uses for name, uses in found.items() if uses} == {}


@pytest.mark.parametrize("law", LAWS)
def test_a_law_names_its_source_and_equations(law):
    source = (ROOT / "controllers" / law).read_text()
    docstring = ast.get_docstring(ast.parse(source)) or ""
    assert re.search(r"^Source: .+?\b(19|20)\d\d\b", docstring, re.MULTILINE | re.DOTALL)
    assert re.search(r"Eqs?\. \(\w+\)", source)


# Files


def listed_files(*options: str) -> list[str]:
    """Names of files as ``git ls-files`` with these options lists them."""
    git = shutil.which("git")
    if git is None:
        pytest.skip("git is not installed, so there is no list of files")
    command = [git, "ls-files", "-z", "--exclude-standard", *options]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode:
        pytest.skip(f"not a git checkout: {listing.stderr.strip()}")
    return [name for name in listing.stdout.split("\0") if name]


def test_no_ignored_file_is_committed():
    # A committed `.venv` link once stopped the installation in every fresh clone.
    assert listed_files("--cached", "--ignored") == []


def test_a_committed_link_stays_inside_the_repository():
    links = [ROOT / name for name in listed_files("--cached") if (ROOT / name).is_symlink()]
    assert [str(link) for link in links if not link.resolve().is_relative_to(ROOT)] == []


def text_files() -> dict[str, str]:
    """All files that are in the repository or could be added to it, and are text."""
    texts = {}
    for name in listed_files("--cached", "--others"):
        path = ROOT / name
        if path.is_file() and b"\0" not in (content := path.read_bytes()):
            texts[name] = content.decode(errors="replace")
    return texts


# The needles are put together here, so that this file does not contain them.
FOLDERS = "|".join(("work", "root", "home", "Users"))
MACHINE_PATH = re.compile(rf"(?<![\w.~}}-])/(?:{FOLDERS})/")
INDEXES = "|".join(("pypi", "pythonhosted", "anaconda", "npmjs", "crates"))
INDEX_HOST = re.compile(rf"(?:{INDEXES})\.(?:org|com|io)\b|index[-_]url", re.IGNORECASE)


@pytest.mark.parametrize(
    ("needle", "text", "found"),
    [
        (MACHINE_PATH, "open('" + "/".join(("", "home", "me", "log")) + "')", True),
        (MACHINE_PATH, "/".join(("", "work", "main")), True),
        (MACHINE_PATH, "tests/house/home/log", False),
        (INDEX_HOST, "https://" + ".".join(("files", "pythonhosted", "org")) + "/x.whl", True),
        (INDEX_HOST, "numpy==2.4.6", False),
    ],
)
def test_needles(needle, text, found):
    assert bool(needle.search(text)) is found


@pytest.mark.parametrize("needle", [MACHINE_PATH, INDEX_HOST], ids=["machine path", "index host"])
def test_no_file_knows_this_machine_or_a_package_index(needle):
    found = [
        f"{name}:{number}: {line.strip()}"
        for name, text in text_files().items()
        for number, line in enumerate(text.splitlines(), 1)
        if needle.search(line)
    ]
    assert found == []


# Dependencies


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    exact = [re.fullmatch(r"([\w.-]+)==([\w.]+)", line) for line in lines if line[:1] != "#"]
    assert all(exact), "constraints.txt holds something else than name==version"
    return {canonicalize_name(pin[1]): pin[2] for pin in exact if pin}


def test_every_dependency_is_pinned_to_a_version_that_satisfies_it():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(chain(project["dependencies"], *project["optional-dependencies"].values()))
    pinned = pins()
    unmet = [
        str(requirement)
        for requirement in map(Requirement, wanted)
        if not requirement.specifier.contains(pinned.get(canonicalize_name(requirement.name), "0"))
    ]
    assert unmet == []


def test_only_the_base_class_of_errors_knows_their_layout():
    """A message with `expected` in its text has empty fields for a caller in Python."""
    written = re.compile(r"  (expected|found|hint) {2,}")
    found = [
        f"{name_of(path)}:{node.lineno}"
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and written.search(node.value)
    ]
    assert found == []
