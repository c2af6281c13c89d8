"""Which code flies: a digest, so that runs of two versions are never mixed."""

import hashlib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FLIES = (
    "testbed/core", "testbed/flight", "testbed/config", "testbed/rig", "controllers", "sim_twin",
)  # fmt: skip
FILES = ("testbed/ops/metrics.py", "testbed/campaign/score.py")


@cache
def code_digest() -> str:
    """Of all sources on which a run's numbers depend."""
    digest = hashlib.blake2b(digest_size=8)
    paths = [path for folder in FLIES for path in sorted((ROOT / folder).rglob("*.py"))]
    for path in (*paths, *(ROOT / name for name in FILES)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def digest_of(data: bytes) -> str:
    """Of anything."""
    return hashlib.blake2b(data, digest_size=8).hexdigest()
