"""Validates a user's law, and records the content of its file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec.structs import replace

from controllers.law_file import LawError, UnusableLawError, content_of, digest, file_of, maker
from controllers.onnx_policy import OnnxParams, try_policy
from controllers.own_law import OwnLawParams, own_law, parameter_type, try_out
from testbed.config.error import Violation, refused
from testbed.config.experiment import Experiment
from testbed.config.validation import first_violation
from testbed.realtime.law_watch import reading

C = TypeVar("C")


def place_law(tree: Any, folder: Path) -> None:
    """Make the path of a law's file absolute; it is relative to `folder`."""
    forks = tree.get("forks")
    for part in (tree, *(forks if isinstance(forks, list) else ())):
        controller = part.get("controller") if isinstance(part, dict) else None
        if not isinstance(controller, dict):
            continue
        law, file = controller.get("law"), controller.get("file")
        if controller.get("type") == "python" and isinstance(law, str) and file_of(law) is not None:
            path, _, name = law.rpartition(":")
            controller["law"] = f"{(folder / path).resolve()}:{name}"
        if controller.get("type") == "onnx" and isinstance(file, str):
            controller["file"] = str((folder / file).resolve())


def bad_own_law(experiment: Experiment) -> Iterator[Violation]:
    """Errors in a user's law."""
    params = experiment.controller
    try:
        if isinstance(params, OwnLawParams):
            with reading(params.law):
                found = _tried(params, list(experiment.vehicles))
            yield from found
        elif isinstance(params, OnnxParams):
            with reading(Path(params.file).name, "file"):
                found = _tried_policy(params)
            yield from found
    except UnusableLawError as error:
        yield refused(("controller", error.key), error)


def _tried(params: OwnLawParams, names: list[str]) -> list[Violation]:
    """Read the file, make the law and call it once."""
    kind = parameter_type(maker(params.law, params.sha256))
    try:
        msgspec.convert(params.parameters, kind)
    except msgspec.ValidationError:
        key, expected, found, _ = first_violation(params.parameters, kind)
        return [Violation(("controller", "parameters", *key), expected, found)]
    try:
        try_out(own_law(params, names, 2), len(names))
    except LawError as error:
        if error.expected:
            found = f"{error.where}: {error.found}"
            return [Violation(("controller", "law"), error.expected, found, error.hint)]
        return [Violation(("controller", "law"), "a law that says what to do", str(error))]
    return []


def _tried_policy(params: OnnxParams) -> list[Violation]:
    """Read the policy and call it."""
    try:
        try_policy(params)
    except LawError as error:
        return [Violation(("controller", "file"), "a policy that says what to do", str(error))]
    return []


def with_content(experiment: Experiment) -> Experiment:
    """The experiment with the current digests of its laws' files."""
    forks = [replace(one, controller=_pinned(one.controller)) for one in experiment.forks]
    return replace(experiment, controller=_pinned(experiment.controller), forks=forks)


def _pinned(params: C) -> C:
    if isinstance(params, OwnLawParams) and params.sha256 is None:
        return replace(params, sha256=content_of(params.law))
    if isinstance(params, OnnxParams) and params.sha256 is None:
        return replace(params, sha256=digest(Path(params.file)))
    return params
