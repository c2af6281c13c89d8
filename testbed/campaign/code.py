"""Which code flies: a digest, so that runs of two versions are never mixed."""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FLIES = (
    "testbed/core", "testbed/flight", "testbed/config", "testbed/rig", "controllers", "sim_twin",
    "firmware_interface",
)  # fmt: skip
FILES = (  # which runs there are, and what a flight's numbers are
    "testbed/campaign/sweep.py", "testbed/campaign/row.py", "testbed/campaign/score.py",
    "testbed/cli/trial.py", "testbed/cli/run.py", "testbed/metrics/run_metrics.py",
    "testbed/metrics/formation.py",
)  # fmt: skip
LIBRARIES = ("numba", "numpy", "scipy")


@cache
def code_digest() -> str:
    """Of all sources on which a run's numbers depend, and the libraries that compute them."""
    digest = hashlib.blake2b(digest_size=8)
    for name in LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    kinds = ("*.py", "*.[ch]")  # a board's firmware is in C
    paths = [p for folder in FLIES for kind in kinds for p in sorted((ROOT / folder).rglob(kind))]
    for path in (*paths, *(ROOT / name for name in FILES)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def digest_of(data: bytes) -> str:
    """Of anything."""
    return hashlib.blake2b(data, digest_size=8).hexdigest()
