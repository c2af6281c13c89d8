"""Finds, loads and dumps experiment files."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from controllers.catalogue import UsersLaw, make_law
from testbed.config.board import bad_board
from testbed.config.error import ConfigError, Violation, did_you_mean, refused
from testbed.config.experiment import Experiment
from testbed.config.fault_schedule import bad_injections
from testbed.config.fit import defaults_of, fit
from testbed.config.fork import bad_forks
from testbed.config.hardware import bad_hardware
from testbed.config.key import Key
from testbed.config.layout import bad_layout
from testbed.config.moving import bad_paths
from testbed.config.network import bad_network
from testbed.config.number import bad_numbers
from testbed.config.own_law import bad_own_law, with_content
from testbed.config.plugin import bad_plugins
from testbed.config.shipped import FAULTS, shipped
from testbed.config.source import Source
from testbed.config.thresholds import (
    Texts,
    resolved,
    take_texts,
    value_of,
    violations_in,
    words_of,
)
from testbed.config.timing import bad_timing
from testbed.config.tree import read_text, read_toml, trouble_at
from testbed.config.validation import first_violation

OTHER_KINDS = {  # by a first key that experiments do not have
    "mass": "a vehicle, which `vehicles.NAME.model` of an experiment names",
    "size": "a table, which `table` of an experiment names",
    "experiment": "a campaign (`testbed campaign`), or of tuning (`testbed tune`)",
    "samples": "a benchmark (`testbed benchmark`)",
}


def find(name: str) -> Path:
    """The file of an experiment given as a path or as the name of a shipped one."""
    path = Path(name)
    trouble = trouble_at(path)
    if trouble is None:
        return path
    known = shipped("experiments")
    if name in known:
        return known[name]
    expected = f"an experiment file or one of: {', '.join(known)}"
    if name and trouble_at(path / "config.toml") is None:
        hint = f" (of a run? its experiment is {path / 'config.toml'})"
    elif name and trouble_at(Path(f"{path}.toml")) is None:
        hint = f" (did you mean `{path}.toml`?)"
    elif path.stem not in known and (scenario := shipped("scenarios").get(path.stem)):
        hint = f" (a scenario of the benchmark? its file is {scenario})"
    else:
        hint = did_you_mean(path.stem, known)
    raise ConfigError(name, "", expected, trouble + hint)


def load(path: Path, overrides: Sequence[str] = ()) -> Experiment:
    """Load and validate an experiment.

    Args:
        path: path of the experiment's TOML.
        overrides: "key=value", applied in order.

    Raises:
        ConfigError: a file or an override is invalid.
    """
    return _checked(Source(read_toml(path), str(path), path.parent), overrides)


def loads(text: str, overrides: Sequence[str] = ()) -> Experiment:
    """Load the text of a resolved experiment, without a file."""
    where = "the resolved experiment"
    return _checked(Source(read_text(text.encode(), where), where, Path()), overrides)


def _checked(source: Source, overrides: Sequence[str]) -> Experiment:
    for text in overrides:
        source.override(text)
    for violation in bad_numbers(source.tree):
        raise source.error(violation)
    texts = take_texts(source.tree.get("faults"))
    try:
        experiment = msgspec.convert(source.tree, Experiment)
    except msgspec.ValidationError:
        violation = first_violation(source.tree, Experiment)
        if len(violation.key) == 1 and (kind := OTHER_KINDS.get(str(violation.key[0]))):
            violation = violation._replace(found=f"{violation.found}: the file of {kind}?")
        raise source.error(violation) from None
    for violation in violations(experiment):
        raise source.error(violation)
    experiment = fit(experiment, source.tree)
    words = words_for(experiment)
    for violation in chain(bad_paths(experiment), violations_in(texts, words)):
        raise source.error(violation)
    faults = resolved(experiment.faults, texts, words)
    return with_content(replace(experiment, faults=faults))


def words_for(experiment: Experiment) -> dict[str, float]:
    """The words of the fault table's arithmetic and their values in an experiment."""
    models = [one.model for one in experiment.vehicles.values()]
    return words_of(models, experiment.table, experiment.flight, experiment.guidance)


def derived_of(experiment: Experiment) -> dict[Key, float]:
    """What an experiment has where no file gives a number: defaults, and bounds of faults."""
    words = words_for(experiment)
    bounds = {
        ("faults", *place): value_of(text, words)
        for place, text in take_texts(read_toml(FAULTS)).items()
    }
    return bounds | {one.key: one.value for one in defaults_of(experiment)}


def fault_texts(path: Path, overrides: Sequence[str] = ()) -> Texts:
    """The arithmetic in the fault table of an experiment."""
    source = Source(read_toml(path), str(path), path.parent)
    for text in overrides:
        source.override(text)
    return take_texts(source.tree.get("faults"))


def violations(experiment: Experiment) -> Iterator[Violation]:
    """Errors that the types do not exclude."""
    yield from chain(bad_layout(experiment), bad_hardware(experiment), bad_timing(experiment))
    yield from bad_own_law(experiment)
    yield from bad_board(experiment)
    yield from bad_injections(experiment)
    yield from bad_network(experiment)
    yield from bad_plugins(experiment)
    yield from bad_forks(experiment, violations)
    if isinstance(experiment.controller, UsersLaw):
        return  # checked by bad_own_law
    try:
        make_law(experiment.controller, list(experiment.vehicles))
    except ValueError as error:
        yield refused(("controller",), error)
    except ArithmeticError as error:
        yield Violation(("controller",), "numbers of ordinary size", str(error))


def dump(experiment: Experiment) -> dict[str, Any]:
    """The experiment as a tree that `tomli_w` can write and `load` can read."""
    return _without_none(msgspec.to_builtins(experiment))


def _without_none(value: Any) -> Any:
    """The tree without null values, which TOML does not have."""
    if isinstance(value, dict):
        return {name: _without_none(v) for name, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_without_none(v) for v in value]
    return value
