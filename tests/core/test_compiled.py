"""What is kept on disk of compiled code, and what is not; in processes of their own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

THEIRS = """
from typing import NamedTuple
import numpy as np
from testbed.core.law import compiled_rate

class Gains(NamedTuple):
    push: float

@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    return {factor} * gains.push * np.ones(own.p.shape[0]), np.empty(0)
"""
OURS = """
from controllers.pd import Gains, rate
"""
FLY = """
import sys
{law}
import numpy as np
from testbed.core.law import Body, CompiledLaw, Discs, Goal, World
from testbed.core.law import no_state, propagate_in_plane, silent
zero = np.zeros(2)
none = Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
own = Body(zero, zero, 2.0, zero, zero, 1e9)
world = World(Goal(zero + 1.0, zero, zero, zero), none)
law = CompiledLaw(Gains({numbers}), no_state, rate)
ahead = law.propagate(np.zeros(0), own, silent(none), world, 0.0, 0.1, 10)
print(ahead.mean_force[0], sum(propagate_in_plane.stats.cache_hits.values()))
"""


@pytest.fixture
def fly(tmp_path):
    """Fly a law in a process of its own: mean force [N], and how much of its code was on disk."""

    def run(law: str, numbers: str, path: Path | None = None) -> tuple[float, int]:
        result = subprocess.run(
            [sys.executable, "-c", FLY.format(law=law, numbers=numbers)],
            env=os.environ
            | {
                "PYTHONPATH": os.pathsep.join(map(str, filter(None, (ROOT, path)))),
                "XDG_CACHE_HOME": str(tmp_path / "cache"),
                "PYTHONDONTWRITEBYTECODE": "1",  # within a second Python itself misses an edit
            },
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        force, hits = result.stdout.split()
        return float(force), int(hits)

    return run


@pytest.mark.slow
def test_a_law_of_a_user_leaves_nothing_on_disk(fly, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    file, law = theirs / "their_law.py", "from their_law import Gains, rate"
    file.write_text(THEIRS.format(factor=1.0))
    assert fly(law, "3.0", theirs) == (pytest.approx(3.0), 0)
    assert fly(OURS, "0.5, 0.0")[1] == 0  # a process that cannot import their file
    assert fly(OURS, "0.5, 0.0")[1] == 1  # ours is kept
    file.write_text(THEIRS.format(factor=2.0))
    assert fly(law, "3.0", theirs) == (pytest.approx(6.0), 0)  # as edited


@pytest.mark.slow
def test_nor_does_a_function_of_ours_that_was_given_a_type_of_theirs(fly, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    law = OURS + "from typing import NamedTuple\nfrom testbed.core.law import compiled_rate\n"
    law += "class Mine(NamedTuple):\n    stiffness: float\n    damping: float\n"
    law += "rate = compiled_rate(Mine)(rate.py_func)\nGains = Mine\n"
    force, hits = fly(law, "0.5, 0.0")
    assert (force, hits) == (pytest.approx(1.0, abs=0.01), 0)
    assert fly(OURS, "0.5, 0.0")[0] == pytest.approx(1.0, abs=0.01)
