"""The folder on disk that compiled code is kept in, and what may be kept there.

Numba keys its disk cache on the file that defines a function, not on the files of the functions it
calls, so after an edit of a callee it would silently run old machine code. We therefore keep one
cache folder per content of *all* our source files: any edit gives a new folder and a new
compilation.

Code that involves a user's own files is compiled again in every process. Beside the machine code of
a function, numba keeps a list of the argument types it has code for. A type from a user's file in
that list cannot be loaded in a process that does not import the file, which makes the function
unusable there; and an edit of that file would not be noticed.

Processes that start together compile a function once: the first one locks it, the others wait and
read its code from the disk.
"""

import fcntl
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core import config
from numba.core.caching import FunctionCache

_ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "testbed/core", "testbed/flight", "testbed/reproduction/kernel", "testbed/rig/fleet",
    "controllers", "sim_twin",
)  # fmt: skip


def _source_digest() -> str:
    digest = hashlib.blake2b(numba.__version__.encode(), digest_size=8)
    for package in PACKAGES:
        paths = sorted((_ROOT / package).rglob("*.py"))
        if not paths:
            raise FileNotFoundError(f"{_ROOT / package}: expected source files")
        for path in paths:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "airbearing-testbed" / _source_digest()


class BundleType(types.Type):
    """Numba's type of a `Bundle` of this inner type, see bundle.py."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner
        super().__init__(name=f"Bundle({inner})")


class CodeType(types.Type):
    """Numba's type of a `CodeAddress` of code with this signature, see code_address.py."""

    def __init__(self, signature: Any) -> None:
        self.signature = signature
        super().__init__(name=f"CodeAddress({signature})")


def is_ours(thing: Callable[..., Any]) -> bool:
    """Whether a function or class is from a source file that determines the cache folder."""
    names = (package.replace("/", ".") for package in PACKAGES)
    return any(thing.__module__ == n or thing.__module__.startswith(f"{n}.") for n in names)


def _is_ours_throughout(kind: Any) -> bool:
    """The same for a numba type; an unknown type is not ours."""
    named, several = isinstance(kind, types.BaseNamedTuple), isinstance(kind, types.BaseTuple)
    if named and not is_ours(kind.instance_class):
        return False
    if several:
        return all(_is_ours_throughout(part) for part in kind)
    if isinstance(kind, types.Array):
        return _is_ours_throughout(kind.dtype)
    if isinstance(kind, BundleType):
        return _is_ours_throughout(kind.inner)
    if isinstance(kind, CodeType):
        return all(map(_is_ours_throughout, (kind.signature.return_type, *kind.signature.args)))
    known = (types.Number, types.Boolean, types.UnicodeType, types.Literal, types.NoneType)
    return isinstance(kind, (*known, types.Omitted, types.Record))  # a record has numbers only


class OwnTypesCache(FunctionCache):
    """Keeps machine code for arguments of our own types only."""

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        self._locked: int | None = None  # descriptor of the lock, while this process compiles

    def load_overload(self, sig: tuple[Any, ...], target_context: Any) -> Any:
        """Code for these argument types; None: compile it, then call `unlock`."""
        found = super().load_overload(sig, target_context)
        if found is None and self._locked is None and all(map(_is_ours_throughout, sig)):
            self._locked = _lock(Path(self.cache_path) / f"{self._impl.filename_base}.lock")
            found = super().load_overload(sig, target_context)
        return found

    def save_overload(self, sig: tuple[Any, ...], data: Any) -> None:
        """Save `data`, compiled for these argument types, only if all types are ours."""
        if all(map(_is_ours_throughout, sig)):
            super().save_overload(sig, data)

    def unlock(self) -> None:
        """Let other processes compile this function."""
        if self._locked is not None:
            os.close(self._locked)
            self._locked = None


def _lock(path: Path) -> int | None:
    """Wait for the lock on this file and take it; None: files cannot be locked here."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
    except BaseException as error:
        os.close(file)
        if isinstance(error, OSError):  # a file system without locks
            return None
        raise
    return file


if "NUMBA_CACHE_DIR" not in os.environ:
    vars(config)["CACHE_DIR"] = str(_cache_folder())
