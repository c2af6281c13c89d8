"""The examples run, and say what the page says of them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SAYS = {
    "compare_two_laws": "lqr",
    "drive_the_twin": "contacts: 0",
    "fly_and_plot": "figures/valves.svg",
    "own_law": "passed",
    "read_a_log": "replayed bit for bit",
    "predict_a_motion": "50 ms later",
    "sweep_a_gain": "100% passed",
}


def test_every_example_is_tried_and_short():
    found = {path.stem: path for path in EXAMPLES.glob("*.py")}
    assert found.keys() == SAYS.keys()
    assert all(len(path.read_text().splitlines()) <= 40 for path in found.values())


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(name, tmp_path):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py")], cwd=tmp_path, capture_output=True,
        text=True, check=False, env=_environment(),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert SAYS[name] in done.stdout
    assert done.stderr == ""


def test_the_notebook_runs(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((EXAMPLES / "first_flight.ipynb").read_text())
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "the notebook is kept without outputs"
            exec("".join(cell["source"]), names)
    assert names["run"].passed
    assert names["softer"].metrics.vehicles["sat1"].settle_s > 10.0
    assert "<svg" in names["run"].plot("trajectory")._repr_html_()


def _environment():
    import os

    return os.environ | {"PYTHONPATH": str(ROOT)}
