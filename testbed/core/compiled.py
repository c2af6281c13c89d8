"""The one decorator for compiled inner loops.

Numba keys its disk cache on the file that defines a function, not on the files of the functions it
calls, so an edit in a callee would silently run old machine code. We therefore keep one cache
folder per content of *all* our source files: an edit anywhere means a new folder and a fresh
compilation.

What involves other people's files is compiled anew in every process. Beside the machine code of a
function, numba keeps a list of the argument types it has code for. A type from somebody's own file
in that list could not be read where that file is not imported, which makes the function unusable
there; and an edit of that file would go unnoticed.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import cgutils, config
from numba.core.caching import FunctionCache
from numba.extending import intrinsic, overload

F = TypeVar("F", bound=Callable[..., Any])
V = TypeVar("V")

# Nobody calls from C: without a wrapper for that there is a tenth less to compile.
LEAN: Any = {"error_model": "numpy", "no_cfunc_wrapper": True}

_ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "testbed/core", "testbed/flight", "testbed/reproduction/kernel", "controllers", "sim_twin",
)  # fmt: skip


def _source_digest() -> str:
    digest = hashlib.blake2b(numba.__version__.encode(), digest_size=8)
    for package in PACKAGES:
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "airbearing-testbed" / _source_digest()


def is_ours(thing: Callable[..., Any]) -> bool:
    """Whether a function or class is from a file whose edits mean a new cache folder."""
    names = (package.replace("/", ".") for package in PACKAGES)
    return any(thing.__module__ == n or thing.__module__.startswith(f"{n}.") for n in names)


def _is_ours_throughout(kind: Any) -> bool:
    """The same for a type as numba knows it; one that we do not know is not ours."""
    named, several = isinstance(kind, types.BaseNamedTuple), isinstance(kind, types.BaseTuple)
    if named and not is_ours(kind.instance_class):
        return False
    if several:
        return all(_is_ours_throughout(part) for part in kind)
    if isinstance(kind, types.Array):
        return _is_ours_throughout(kind.dtype)
    known = (types.Number, types.Boolean, types.UnicodeType, types.Literal, types.NoneType)
    return isinstance(kind, (*known, types.Omitted))


class OwnTypesCache(FunctionCache):
    """Keeps machine code for arguments of our own types only."""

    def save_overload(self, sig: tuple[Any, ...], data: Any) -> None:
        """Keep `data`, compiled for arguments of these types, or do not."""
        if all(_is_ours_throughout(kind) for kind in sig):
            super().save_overload(sig, data)


if "NUMBA_CACHE_DIR" not in os.environ:
    vars(config)["CACHE_DIR"] = str(_cache_folder())


def compiled(function: F) -> F:
    """Compile `function` to machine code on first use; keep the result on disk if it is all ours.

    No fast-math: results must be the same bit for bit on every run. The plain Python function
    stays reachable as `function.py_func`.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """The same, copied into every compiled function that calls it.

    For innermost loops: what a law sees is two hundred words, and a call would hand over them all.
    """
    return _compiled(function, forceinline=True)


def pasted(function: F) -> F:
    """Compile `function` only as part of whoever calls it.

    For what is called in one place with many arguments: it is compiled once and not twice. There
    is no call that holds on to arguments: what it borrows of them the caller must `keep`.
    """
    return cast(F, numba.njit(error_model="numpy", inline="always")(function))


def settled(function: F) -> F:
    """The same compiled function, for one caller whose arguments are of the same types for ever.

    At every call numba finds out the types of all arguments, down to the last array of a tuple:
    for the small functions of a tick that takes longer than what they do. Here it is done at the
    first call, and again if a whole number is one no longer: it would be cut off, silently. So a
    settled function has one owner, who hands over what looks alike every time: arrays of the same
    number of dimensions, layout and kind, and tuples of the same kinds. That nothing checks
    (tests/experiments/test_settled.py flies with the types compared at every call).
    """
    direct: Callable[..., Any] | None = None
    whole: list[int] = []  # which arguments are whole numbers

    def call(*args: Any) -> Any:
        nonlocal direct, whole
        for k in whole:
            if not isinstance(args[k], int):
                direct = None
        if direct is None:
            direct = _machine_code(cast(Any, function), args)
            whole = [k for k, value in enumerate(args) if isinstance(value, int)]
        return direct(*args)

    return cast(F, call)


def _machine_code(function: Any, args: tuple[Any, ...]) -> Callable[..., Any]:
    """What numba runs for arguments that look like these; found once for all owners.

    Among a hundred vehicles each asking numba is a tenth of a short flight.
    """
    found: dict[Any, Callable[..., Any]] = function.__dict__.setdefault("machine_code", {})
    if (code := found.get(look := _look(args))) is None:
        code = found[look] = function.compile(tuple(map(numba.typeof, args)))
    return code


def _look(value: Any) -> Any:
    """Values that look alike are of one type to numba; arrays of one type may look different.

    Raises:
        TypeError: for a list or the like, whose type hangs on what is in it.
    """
    if isinstance(value, (list, set, dict)):
        raise TypeError(f"expected arrays, tuples and numbers, found a {type(value).__name__}")
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    return (type(value), *map(_look, value)) if isinstance(value, tuple) else type(value)


def _compiled(function: F, *, forceinline: bool = False) -> F:
    dispatcher: Any = numba.njit(**LEAN, forceinline=forceinline)(function)
    if is_ours(function):
        dispatcher._cache = OwnTypesCache(function)  # what `cache=True` does, but for the class
    return cast(F, dispatcher)


def _without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Code for `value` with the owner of every array in it struck out."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        kinds, parts = list(cast(Any, kind)), cgutils.unpack_tuple(builder, value, len(kind))
        lent = [_without_counts(context, builder, *pair) for pair in zip(kinds, parts, strict=True)]
        return context.make_tuple(builder, kind, lent)
    return value


@intrinsic
def _lend(typingctx: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _without_counts(context, builder, signature.args[0], args[0])

    return value(value), code


@intrinsic
def _hold(typingctx: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.get_dummy_value()

    return types.void(value), code


def borrowed(value: V) -> V:
    """The same arrays, or (nested) tuples of arrays, without counting who uses them.

    In compiled code every use of an array of a tuple counts references up and down, with atomic
    instructions: two thirds of a law's time. What is borrowed is not counted. The owner must
    outlive it: arguments that came from Python do, and so does what is handed to `keep` afterwards.
    """
    return value


def keep(value: object) -> None:
    """Make `value` live until here."""


@overload(borrowed, jit_options={"forceinline": True})
def _borrowed(value: Any) -> Any:
    def compiled_borrowed(value: Any) -> Any:
        return _lend(value)  # type: ignore[call-arg]

    return compiled_borrowed


@overload(keep, jit_options={"forceinline": True})
def _keep(value: Any) -> Any:
    def compiled_keep(value: Any) -> None:
        _hold(value)  # type: ignore[call-arg]

    return compiled_keep
