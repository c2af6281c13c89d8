"""The one decorator for compiled inner loops.

Numba keys its disk cache on the file that defines a function, not on the files of the functions it
calls, so an edit in a callee would silently run old machine code. We therefore keep one cache
folder per content of *all* our source files: an edit anywhere means a new folder and a fresh
compilation.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config

F = TypeVar("F", bound=Callable[..., Any])

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = (
    "testbed/core", "testbed/flight", "testbed/reproduction/kernel", "controllers", "sim_twin",
)  # fmt: skip


def _source_digest() -> str:
    digest = hashlib.blake2b(numba.__version__.encode(), digest_size=8)
    for package in _PACKAGES:
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "airbearing-testbed" / _source_digest()


if "NUMBA_CACHE_DIR" not in os.environ:
    vars(config)["CACHE_DIR"] = str(_cache_folder())


def compiled(function: F) -> F:
    """Compile `function` to machine code on first use and keep the result on disk.

    No fast-math: results must be the same bit for bit on every run. The plain Python function
    stays reachable as `function.py_func`.
    """
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))
