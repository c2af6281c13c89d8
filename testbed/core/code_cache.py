"""The folder on disk that compiled code is kept in, and what may be kept there.

Numba keys its disk cache on the file that defines a function, not on the files of the functions it
calls, so after an edit of a callee it would silently run old machine code. We therefore stamp code
with the content of *all* our source files: any edit gives a new folder and a new compilation.

Within the folder a function is found by its module, not by the path of its file, and on x86 it is
compiled for all processors with AVX2 (x86-64-v3), not only for the one at hand. So machine code can
be moved: a wheel may bring it along (`SHIPPED`, see run/machine_code.py).

Code that involves a user's own files is compiled again in every process. Beside the machine code of
a function, numba keeps a list of the argument types it has code for. A type from a user's file in
that list cannot be loaded in a process that does not import the file, which makes the function
unusable there; and an edit of that file would not be noticed.

Processes that start together compile a function once: the first one locks it, the others wait and
read its code from the disk.

A process may load code that several others have compiled. Numba names code by the function, the
names of its argument types and a number that it counts from 1 in every process. Two laws whose
gains have the same class name and the same fields would have code of one name, and the process that
loads both would fly the first one for both. So each process begins to count somewhere else.
"""

import fcntl
import hashlib
import os
import platform
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any, Self

import numba
import numba.cpython.hashing  # gives LLVM the seeds of Python's hashes
import numba.np.linalg
from llvmlite.binding import get_host_cpu_features
from numba import types
from numba.core import config
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime import rtsys

_ROOT = Path(__file__).resolve().parents[2]
SHIPPED = _ROOT / "testbed" / "machine_code"  # in a wheel of `make wheel`; has one such folder

# What x86-64-v3 may use; Intel's Core since 2013 and AMD's Zen since 2017 have it.
X86_64_V3 = "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2"

PACKAGES = (
    "testbed/core", "testbed/flight", "testbed/reproduction/kernel", "testbed/rig/fleet",
    "controllers", "sim_twin",
)  # fmt: skip


@cache
def source_digest() -> str:
    """The name of the folder for code of these sources and this numba."""
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
    return Path(base) / "airbearing-testbed" / source_digest()


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
    """Whether a numba type and all its parts are ours; an unknown type is not."""
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


class ModuleLocator:
    """Where numba keeps the code of one of our functions: in a folder named after its module."""

    def __init__(self, folder: Path, line: int) -> None:
        self._folder, self._line = folder, line

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Self | None:
        """None: nothing can be kept there, and numba asks the next locator."""
        base = vars(config)["CACHE_DIR"]
        if not base or not _writable(folder := Path(base) / py_func.__module__):
            return None
        return cls(folder, py_func.__code__.co_firstlineno)

    def ensure_cache_path(self) -> None:
        """Make the folder, if someone has removed it."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Code with another stamp is old."""
        return source_digest()

    def get_disambiguator(self) -> str:
        """Tells functions of one name apart."""
        return str(self._line)


@cache
def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


class _Files(CompileResultCacheImpl):
    _locator_classes = [ModuleLocator, *CompileResultCacheImpl._locator_classes]  # noqa: RUF012, SLF001


class OwnTypesCache(FunctionCache):
    """Keeps machine code for arguments of our own types only; reads what is shipped, too."""

    _impl_class = _Files

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        mine = self._cache_file
        folder = SHIPPED / source_digest() / py_func.__module__
        names = str(folder), self._impl.filename_base, source_digest()
        self._shipped = type(mine)(*names) if folder.is_dir() else None
        self._locked: int | None = None  # descriptor of the lock, while this process compiles

    def load_overload(self, sig: tuple[Any, ...], target_context: Any) -> Any:
        """Code for these argument types; None: compile it, then call `unlock`.

        Numba would first load all that it needs to compile, which takes 0.4 s; its compiler does
        that, too. Code that is found needs numba's functions for memory, and the seeds of hashes.
        """
        rtsys.initialize(target_context)
        found = self._load_shipped(sig, target_context)
        if found is None:
            found = self._load_kept(sig, target_context)
        if found is None and self._locked is None and all(map(_is_ours_throughout, sig)):
            self._locked = _lock(Path(self.cache_path) / f"{self._impl.filename_base}.lock")
            found = self._load_kept(sig, target_context)
        return found

    def _load_kept(self, sig: tuple[Any, ...], target_context: Any) -> Any:
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)
        return None  # a file could not be read

    def _load_shipped(self, sig: tuple[Any, ...], target_context: Any) -> Any:
        if self._shipped is None:
            return None
        data = self._shipped.load(self._index_key(sig, target_context.codegen()))
        return None if data is None else self._impl.rebuild(target_context, data)

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


def has_code(name: str) -> bool:
    """Whether code of this function (`module.function`, as numba writes it) is shipped or kept."""
    folders = [SHIPPED / source_digest(), *filter(None, [vars(config)["CACHE_DIR"]])]
    files = f"{name}-*.py{sys.version_info.major}{sys.version_info.minor}*.nbi"
    return any(next(Path(folder).rglob(files), None) is not None for folder in folders)


def _count_from_elsewhere() -> None:
    """Let numba name code as no other process does."""
    FunctionIdentity._unique_ids = count(int.from_bytes(os.urandom(6), "little"))  # noqa: SLF001


def _processor() -> str | None:
    """The kind of processor to compile for; None: this machine's own."""
    if platform.machine() != "x86_64":
        return None
    has = get_host_cpu_features()
    return "x86-64-v3" if all(has.get(feature) for feature in X86_64_V3) else None


def _load_array_functions() -> None:
    """Load numba's functions of arrays without scipy.linalg, which would take 0.2 s.

    Numba asks for it when they are loaded, and again when compiled code multiplies matrices.
    """
    asks = numba.np.linalg.ensure_blas
    numba.np.linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        numba.np.linalg.ensure_blas = asks


_load_array_functions()
_count_from_elsewhere()
os.register_at_fork(after_in_child=_count_from_elsewhere)
if "NUMBA_CACHE_DIR" not in os.environ:
    vars(config)["CACHE_DIR"] = str(_cache_folder())
if "NUMBA_CPU_NAME" not in os.environ and (_kind := _processor()) is not None:
    vars(config).update(CPU_NAME=_kind, CPU_FEATURES="")
