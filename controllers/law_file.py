"""Finds, executes and locates errors in the file of a law outside the package."""

import hashlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from traceback import extract_tb
from types import FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from testbed.core import plugin
from testbed.core.error import MismatchError, TestbedError

LONGEST = 500  # message of a law's error [characters]; it goes into the log and over the network
_IMPORTED: WeakKeyDictionary[ModuleType, str] = WeakKeyDictionary()  # digests, when first asked for


class UnusableLawError(MismatchError):
    """A law cannot be made; `key` is the key of [controller] to correct."""

    def __init__(self, key: str, expected: str, found: str) -> None:
        super().__init__(expected, found)
        self.key = key


class LawError(TestbedError):
    """A law failed when it was called; the message, one line, names the line in its file.

    Args:
        where: place in the law's file, or the whole message.
        expected: what the law should return.
        found: what it returned.
        hint: what to do.
    """

    def __init__(self, where: str, expected: str = "", found: str = "", hint: str = "") -> None:
        detail = f": expected {expected}, found {found}; {hint}" if expected else ""
        super().__init__(f"{where}{detail}")  # in one line, for the fault of a flight
        self.where, self.expected, self.found, self.hint = where, expected, found, hint


class LawStoppedError(BaseException):
    """Raised inside a law to end its call, for instance because it takes too long.

    Not an `Exception`, so that a law with `except Exception` does not continue.
    """


def file_of(law: str) -> Path | None:
    """The file that "path.py:Name" names; None for an entry point."""
    path, colon, name = law.rpartition(":")
    return Path(path) if colon and name.isidentifier() else None


def source_of(law: str) -> Path | None:
    """Source file of a law, also if `law` is an entry point; None: no file.

    Raises:
        UnusableLawError: see `maker`.
    """
    if (path := file_of(law)) is not None:
        return path
    file = getattr(_module(law, _published(law)), "__file__", None)
    return None if file is None else Path(file)


def content_of(law: str) -> str | None:
    """SHA-256 of a law's source file; None: no file.

    A module is imported once in a process. What counts is its file as it was when it was asked for
    first, because a later edit does not fly.

    Raises:
        UnusableLawError: see `maker`.
    """
    if (path := file_of(law)) is not None:
        return digest(path)
    module = _module(law, _published(law))
    if module not in _IMPORTED:
        if (source := source_of(law)) is None:
            return None
        _IMPORTED[module] = digest(source)
    return _IMPORTED[module]


def digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(_content(path)).hexdigest()


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        expected = 'the path of a Python file and a name in it, "my_law.py:Name"'
        raise UnusableLawError("law", expected, f"{path}: {reason}") from None


def maker(law: str, sha256: str | None = None) -> Callable[..., Any]:
    """The class or function named by "path.py:Name" or by an entry point.

    Raises:
        UnusableLawError: no such file or name, the file fails, or its SHA-256 differs.
    """
    path = file_of(law)
    if path is None:
        if sha256 not in (None, found := content_of(law)):
            where = source_of(law)
            raise _edited(sha256, f"{found}: {where.name if where else law} of its package")
        return _published(law)
    content = _content(path)
    found = hashlib.sha256(content).hexdigest()
    if sha256 not in (None, found):
        raise _edited(sha256, f"{found}: {path.name}")
    names = vars(_executed(path, content, f"own_law_{found}"))
    name = law.rpartition(":")[2]
    made = names.get(name)
    if not callable(made):
        own = [n for n, v in names.items() if getattr(v, "__module__", "") == names["__name__"]]
        expected = f"a class or function of {path.name}: {', '.join(own) or 'it defines none'}"
        raise UnusableLawError(
            "law", expected, f"`{name}`" + ", which is neither" * (made is not None)
        )
    return made


def _edited(sha256: str | None, found: str) -> UnusableLawError:
    expected = f"{sha256} (remove the key to accept any content)"
    return UnusableLawError("sha256", expected, f"{found} was edited")


def _published(name: str) -> Callable[..., Any]:
    try:
        return plugin.load(plugin.LAWS, name)
    except plugin.UnknownPluginError as error:
        expected = f'"my_law.py:Name", or {error.expected}'
        raise UnusableLawError("law", expected, error.found) from error
    except plugin.PluginError as error:
        found = error.found if error.__cause__ is None else blame(error.__cause__, None)
        raise UnusableLawError("law", error.expected, found) from error


def _module(name: str, made: Callable[..., Any]) -> ModuleType:
    """Where the law of an entry point is written: not always in the module that offers it."""
    if isinstance(made, type | FunctionType) and made.__module__ in sys.modules:
        return sys.modules[made.__module__]
    return sys.modules[plugin.find(plugin.LAWS, name).module]


def _executed(path: Path, content: bytes, name: str) -> ModuleType:
    """The module of a file, executed again for each law, so that laws share no module state.

    A module with compiled functions is executed once per content: numba identifies types by their
    class, so executing it again would compile it again, and compiled code treats module globals as
    constants.
    """
    before = sys.modules.get(name)
    if before is not None and _is_compiled(before):
        return before
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # annotations are looked up here
    try:
        exec(compile(content, str(path), "exec"), vars(module))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # it is the user's code, and may call sys.exit
        del sys.modules[name]
        raise UnusableLawError(
            "law", "a Python file that can be executed", blame(error, path)
        ) from error
    return module


def _is_compiled(module: ModuleType) -> bool:
    """Whether the module itself, not only its imports, defines functions compiled by numba."""
    own = [v for v in vars(module).values() if getattr(v, "__module__", "") == module.__name__]
    inside = [
        getattr(v, "__func__", v)
        for one in own
        if isinstance(one, type)
        for v in vars(one).values()
    ]
    return any(
        kind.__module__.startswith("numba.")  # the testbed's own decorators subclass numba's
        for value in (*own, *inside)
        for kind in type(value).__mro__
    )


def blame(error: BaseException, path: Path | None) -> str:
    """Line and cause of an error in a law's file, as one line of text that any file can hold."""
    text = _blame(error, path)
    return "".join(
        sign if sign.isprintable() else sign.encode("unicode_escape").decode()
        for sign in text[:LONGEST]
    )


def _text_of(error: BaseException) -> str:
    try:
        return str(error)
    except Exception as another:  # a law's own exception may define its text
        return f"its text cannot be read: {type(another).__name__}"


def _blame(error: BaseException, path: Path | None) -> str:
    whole = re.sub(r"\x1b\[[\d;]*m", "", _text_of(error))  # numba writes in bold
    reason = next((line for line in whole.splitlines() if _says_something(line)), "")
    text = f"{type(error).__name__}: {reason.strip()}"
    if isinstance(error, SystemExit):
        text = f"called sys.exit({'' if error.code is None else repr(error.code)})"
    elif isinstance(error, LawStoppedError):
        text = whole
    if path is None:
        return text
    if isinstance(error, SyntaxError) and error.lineno:
        return f"{path.name}:{error.lineno}: {text}"
    frames = [frame for frame in extract_tb(error.__traceback__) if frame.filename == str(path)]
    if frames:
        return f"{path.name}:{frames[-1].lineno}, in {frames[-1].name}: {text}"
    lines = re.findall(rf'File "[^"]*{re.escape(path.name)}", line (\d+)', whole)
    return f"{path.name}:{lines[-1]}: {text}" if lines else f"{path.name}: {text}"


def _says_something(line: str) -> bool:
    """Whether a line of an error message is informative: numba's first line is not."""
    return bool(line.strip()) and not line.startswith("Failed in nopython mode pipeline")
