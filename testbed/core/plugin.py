"""Plug-ins: entry points of installed packages, found by name.

    [project.entry-points."testbed.laws"]
    springs = "my_package:Springs"

A plug-in is a class or a function. It is called with the options of the file that names it; they
must fit its annotations. Parameters of certain names are not options: the testbed fills them in.
Installed packages are looked through only when a file names something that is not built in.
"""

import inspect
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import msgspec
from msgspec import Struct

from testbed.core.error import MismatchError
from testbed.core.spelling import did_you_mean

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

LAWS, MOCAP, THRUSTERS = "testbed.laws", "testbed.mocap", "testbed.thrusters"  # groups
PROVIDED = {  # parameters that the testbed fills in, not options
    LAWS: (
        "names",  # of the satellites, in the order of `Body.vehicle_index`
        "d",  # number of coordinates of a position
    ),
    MOCAP: ("wire",),  # `MocapWire`, the whole of [lab.mocap]
    THRUSTERS: ("vehicle", "name", "clock"),  # `Vehicle`, its name, a `Timer`
}

Plugin = Callable[..., Any]


class PluginError(MismatchError):
    """A plug-in cannot be used: what was expected, what was found."""


class UnknownPluginError(PluginError):
    """No package that is installed here has the name."""


def find(group: str, name: str, built_in: Iterable[str] = ()) -> "EntryPoint":
    """The entry point of a name.

    Args:
        group: of entry points.
        name: of the entry point.
        built_in: names that could have been meant as well, for the message.

    Raises:
        PluginError: two packages publish the name, or none: `UnknownPluginError`.
    """
    published = _published(group, tuple(sys.path))
    same = {point.value: point for point in published if point.name == name}
    if not same:
        known = [*built_in, *sorted({point.name for point in published})]
        wanted = f"one of: {', '.join(known)}; or " if known else ""
        raise UnknownPluginError(
            f"{wanted}an entry point in the group {group} of a package that is installed here",
            f'"{name}"{did_you_mean(name, known)}',
        )
    if len(same) > 1:
        both = ", ".join(sorted(same))
        raise PluginError("a name that one package publishes", f'"{name}" of {both}')
    return next(iter(same.values()))


@lru_cache(maxsize=8)  # a campaign asks before each of its runs
def _published(group: str, path: tuple[str, ...]) -> "tuple[EntryPoint, ...]":
    """All entry points of a group that the packages on `path`, which is sys.path, offer."""
    from importlib.metadata import entry_points  # only a plug-in should cost this import

    return tuple(entry_points(group=group))


def load(group: str, name: str, built_in: Iterable[str] = ()) -> Plugin:
    """The class or function behind an entry point; arguments as for `find`.

    Raises:
        PluginError: it is not found, or cannot be imported.
    """
    point = find(group, name, built_in)
    try:
        plugin = point.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a plug-in may raise anything, or call sys.exit
        found = f"{type(error).__name__}: {error}"
        raise PluginError("an entry point that can be imported", found) from error
    if not callable(plugin):
        raise PluginError("an entry point that names a class or function", f"{point.value}")
    return cast(Plugin, plugin)


def option_type(plugin: Plugin, provided: Iterable[str]) -> type[Struct]:
    """The options of a plug-in as a struct that refuses unknown keys.

    Args:
        plugin: the class or function.
        provided: names of parameters that the testbed fills in.

    Raises:
        PluginError: it has parameters without names, or annotations that name nothing.
    """
    name = getattr(plugin, "__name__", type(plugin).__name__)
    if inspect.isclass(plugin) and issubclass(plugin, Struct):
        return msgspec.defstruct(name, [], bases=(plugin,), forbid_unknown_fields=True)
    function = getattr(plugin, "__init__", plugin) if inspect.isclass(plugin) else plugin
    try:
        hints = typing.get_type_hints(function, include_extras=True)
    except Exception as error:  # an annotation may be any expression
        raise PluginError("parameters whose annotations can be read", f"{error}") from error
    fields: list[tuple[str, Any, Any]] = []
    for key, one in inspect.signature(plugin).parameters.items():
        if one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD, one.POSITIONAL_ONLY):
            raise PluginError("parameters that all have names", f"`{one}` among those of {name}")
        if key not in provided:
            default = msgspec.NODEFAULT if one.default is one.empty else one.default
            fields.append((key, hints.get(key, Any), default))
    return msgspec.defstruct(name, fields, forbid_unknown_fields=True, kw_only=True)


def call(plugin: Plugin, options: Struct, provided: Mapping[str, Any]) -> Any:
    """Call a plug-in with its options and with the parameters that it has among `provided`."""
    if isinstance(plugin, type) and isinstance(options, plugin):
        return options
    asked = inspect.signature(plugin).parameters
    given = {key: getattr(options, key) for key in options.__struct_fields__}
    return plugin(**given, **{key: provided[key] for key in provided if key in asked})
