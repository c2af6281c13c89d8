"""Parameters of a law that may change in flight: its real numbers, with their bounds."""

from typing import Any

import msgspec
from msgspec import Struct, inspect

from controllers.law_file import UnusableLawError, maker
from controllers.own_law import OwnLawParams, parameter_type
from testbed.config.error import ConfigError
from testbed.config.experiment import Experiment
from testbed.config.key import spell
from testbed.config.number import bad_numbers

FIXED = ("scale",)  # the units of the law's own numbers
OWN = "parameters"  # of a user's law


class Tunable(Struct, frozen=True):
    """A parameter, its value and its bounds."""

    name: str  # in [controller], with dots
    value: float
    low: float | None = None  # null: no bound
    high: float | None = None
    open_low: bool = False  # the bound itself is excluded
    open_high: bool = False


def tunables(controller: Any) -> list[Tunable]:
    """All of a law's."""
    found = _of(controller, type(controller), "")
    if isinstance(controller, OwnLawParams):
        try:
            kind = parameter_type(maker(controller.law, controller.sha256))
            found += _of(msgspec.convert(controller.parameters, kind), kind, f"{OWN}.")
        except (UnusableLawError, msgspec.ValidationError):
            return found  # a law that cannot be read has no sliders
    return found


def _of(values: Any, kind: type, prefix: str) -> list[Tunable]:
    info, found = inspect.type_info(kind), []
    if not isinstance(info, inspect.StructType):
        return []
    for field in info.fields:
        value = getattr(values, field.name)
        options = field.type.types if isinstance(field.type, inspect.UnionType) else (field.type,)
        name = f"{prefix}{field.encode_name}"
        if name in FIXED or isinstance(value, bool):
            continue
        if isinstance(value, Struct):
            found += _of(value, type(value), f"{name}.")
        elif isinstance(value, int | float):
            found += [_tunable(name, value, k) for k in options if isinstance(k, inspect.FloatType)]
    return found


def _tunable(name: str, value: float, kind: inspect.FloatType) -> Tunable:
    low, high = kind.ge if kind.gt is None else kind.gt, kind.le if kind.lt is None else kind.lt
    return Tunable(name, float(value), low, high, kind.gt is not None, kind.lt is not None)


def retuned(experiment: Experiment, values: dict[str, float]) -> Experiment:
    """The experiment with other values of its law's parameters.

    Raises:
        ConfigError: there is no such parameter, or a value is out of its bounds.
    """
    known = {one.name for one in tunables(experiment.controller)}
    for wrong in bad_numbers(dict(values)):
        raise ConfigError("live gains", spell(wrong.key), wrong.expected, wrong.found)
    tree = msgspec.to_builtins(experiment.controller)
    for name, value in values.items():
        if name not in known:
            expected = f"one of: {', '.join(sorted(known)) or 'none: this law has none'}"
            raise ConfigError("live gains", f"controller.{name}", expected, "another parameter")
        *inner, last = name.split(".")
        section = tree
        for word in inner:
            section = section[word]
        section[last] = value
    kind = type(experiment.controller)
    try:
        controller = msgspec.convert(tree, kind)
        if isinstance(controller, OwnLawParams):
            made = maker(controller.law, controller.sha256)
            msgspec.convert(controller.parameters, parameter_type(made))
    except (msgspec.ValidationError, UnusableLawError) as error:
        found = ", ".join(f"{name} = {value:g}" for name, value in values.items())
        raise ConfigError("live gains", "controller", _bounds(experiment, values) or str(error),
                          found) from None  # fmt: skip
    return msgspec.structs.replace(experiment, controller=controller)


def _bounds(experiment: Experiment, values: dict[str, float]) -> str:
    """The bounds of these parameters, in words."""
    words = []
    for one in tunables(experiment.controller):
        if one.name in values:
            low = "" if one.low is None else f"{'>' if one.open_low else '>='} {one.low:g}"
            high = "" if one.high is None else f"{'<' if one.open_high else '<='} {one.high:g}"
            if low or high:
                words.append(f"{one.name} {' and '.join(filter(None, (low, high)))}")
    return ", ".join(words)
