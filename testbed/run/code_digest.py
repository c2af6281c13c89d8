"""Version and digest of the code, so that runs of two versions are never mixed."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (  # code that flies and judges
    "testbed/core", "testbed/flight", "testbed/config", "testbed/faults", "testbed/metrics",
    "testbed/rig", "controllers", "sim_twin", "firmware_interface",
)  # fmt: skip
FILES = (  # code that plans runs and computes their numbers
    "testbed/campaign/sweep.py", "testbed/campaign/row.py", "testbed/campaign/score.py",
    "testbed/campaign/trial.py", "testbed/run/fly.py", "testbed/run/judge.py",
)  # fmt: skip
LIBRARIES = ("numba", "numpy", "scipy")


def own_version() -> str:
    """This package's version; it may be run from its sources without being installed."""
    try:
        return version("airbearing-testbed")
    except PackageNotFoundError:
        return "not-installed"


@cache
def code_digest() -> str:
    """Digest of all sources and library versions that determine a run's numbers."""
    digest = hashlib.blake2b(digest_size=8)
    for name in LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    kinds = ("*.py", "*.[ch]")  # a board's firmware is in C
    paths = [p for folder in FOLDERS for kind in kinds for p in sorted((ROOT / folder).rglob(kind))]
    for path in (*paths, *(ROOT / name for name in FILES)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def digest_of(data: bytes) -> str:
    """Digest of some bytes, as hex."""
    return hashlib.blake2b(data, digest_size=8).hexdigest()
