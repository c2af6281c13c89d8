"""Validates a user's own law, and records the content of its file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from controllers.law_file import UnusableLawError, content_of, file_of, maker
from controllers.own_law import OwnLawParams, own_law, parameter_type, try_out
from controllers.plain_law import LawError
from testbed.config.error import Violation, refused
from testbed.config.experiment import Experiment
from testbed.config.validation import first_violation
from testbed.realtime.law_watch import reading


def place_law(tree: Any, folder: Path) -> None:
    """Make the path of a law's file absolute; it is relative to `folder`."""
    controller = tree.get("controller")
    if isinstance(controller, dict) and controller.get("type") == "python":
        law = controller.get("law")
        if isinstance(law, str) and file_of(law) is not None:
            path, _, name = law.rpartition(":")
            controller["law"] = f"{(folder / path).resolve()}:{name}"


def bad_own_law(experiment: Experiment) -> Iterator[Violation]:
    """Errors in a user's own law."""
    params = experiment.controller
    if not isinstance(params, OwnLawParams):
        return
    try:
        with reading(params.law):
            found = _tried(params, list(experiment.vehicles))
        yield from found
    except UnusableLawError as error:
        yield refused(("controller", error.key), error)


def _tried(params: OwnLawParams, names: list[str]) -> list[Violation]:
    """Read the file, make the law and call it once."""
    kind = parameter_type(maker(params.law, params.sha256))
    try:
        msgspec.convert(params.parameters, kind)
    except msgspec.ValidationError:
        key, expected, found = first_violation(params.parameters, kind)
        return [Violation(("controller", "parameters", *key), expected, found)]
    try:
        try_out(own_law(params, names, 2), len(names))
    except LawError as error:
        return [Violation(("controller", "law"), "a law that says what to do", str(error))]
    return []


def with_content(experiment: Experiment) -> Experiment:
    """The experiment with the current digest of its law's file."""
    params = experiment.controller
    if not isinstance(params, OwnLawParams) or params.sha256 is not None:
        return experiment
    sha256 = content_of(params.law)
    return replace(experiment, controller=replace(params, sha256=sha256))
