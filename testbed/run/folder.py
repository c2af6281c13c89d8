"""A run's folder: never overwritten, and readable after any end of the run.

config.toml   the resolved experiment: `testbed run config.toml` repeats the run
log.mcap      every tick's inputs and outputs
metrics.json  the metrics; "completed": false if the run did not reach its end
*.py          a copy of the law if it is a file outside the package; config.toml refers to it.
              It keeps its name, which appears in the law's errors and so in the log. Of a law of
              an installed package it is a copy to read; config.toml refers to the package.
*.onnx        a copy of the policy; config.toml refers to it
"""

import os
import shutil
import time
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from shutil import disk_usage
from typing import Any

import msgspec
import tomli_w

from controllers.law_file import digest, file_of, source_of
from firmware_interface.compiler import firmware_id
from testbed.config import Experiment, dump
from testbed.core.error import TestbedError
from testbed.files import write_atomic
from testbed.metrics.run_metrics import Metrics
from testbed.report.provenance import FLOWN, versions
from testbed.run.code_digest import code_digest

LEAST_FREE = 50_000_000  # 20 MB are kept to end the log; the rest is an hour of one vehicle [bytes]


class FolderError(TestbedError):
    """The run folder cannot be written."""


def utc_ns() -> int:
    """Time of day [ns]."""
    return time.time_ns()


def new_folder(out: Path | None, name: str, option: str = "--out") -> Path:
    """Make the folder of a new run.

    Args:
        out: the folder; it may exist if it is empty. None: a new one in runs/.
        name: name of the experiment.
        option: how the caller names another folder.

    Raises:
        FolderError: the folder is not empty or not writable, or its disk is nearly full.
    """
    try:
        check_space(Path("runs") if out is None else out, option)
        if out is not None:
            if out.exists() and (not out.is_dir() or any(out.iterdir())):
                found = "older files in it" if out.is_dir() else "a file"
                raise FolderError(where=str(out), expected="a new or empty folder", found=found)
            out.mkdir(parents=True, exist_ok=True)
            if not os.access(out, os.W_OK | os.X_OK):
                raise FolderError(f"{out}: Permission denied")
            return out
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        for k in range(1, 1000):
            path = Path("runs") / (f"{stamp}_{name}" if k == 1 else f"{stamp}_{name}-{k}")
            try:
                path.mkdir(parents=True)
            except FileExistsError:
                continue
            return path
    except OSError as error:
        raise FolderError(
            where=str(error.filename), expected=f"a writable place; choose another with {option}",
            found=str(error.strerror),
        ) from None  # fmt: skip
    raise FolderError(f"runs/{stamp}_{name}: a thousand runs in one second")


def check_space(folder: Path, option: str) -> None:
    """Refuse a disk on which the log would end during the flight.

    Args:
        folder: on the disk; it need not exist yet.
        option: how the caller names another folder.

    Raises:
        FolderError: less than LEAST_FREE is free.
        OSError: its disk cannot be looked at.
    """
    place = folder.absolute()
    free = disk_usage(next(one for one in (place, *place.parents) if one.exists())).free
    if free < LEAST_FREE:
        raise FolderError(
            where=str(folder), expected=f"at least {LEAST_FREE / 1e6:.0f} MB free on its disk",
            found=f"{free / 1e6:.1f} MB",
            hint=f"free some space, or choose another disk with {option}",
        )  # fmt: skip


def take_back(folder: Path) -> None:
    """Remove the folder of a run that was refused before it had a log."""
    if not (folder / "log.mcap").exists():
        shutil.rmtree(folder, ignore_errors=True)


def write_config(folder: Path, tree: dict[str, Any], version: str) -> None:
    """Write the resolved experiment, and a copy of the law if it is a user's file."""
    tree = {**tree, "controller": _keep_law(folder, tree.get("controller", {}))}
    forks = [
        {**fork, "controller": _keep_law(folder, fork["controller"])}
        if "controller" in fork else fork
        for fork in tree.get("forks", ())
    ]  # fmt: skip
    tree = {**tree, "forks": forks}
    head = f"# Resolved by airbearing-testbed {version}; everything is in place.\n{flown_by()}\n"
    _replace(folder / "config.toml", head + tomli_w.dumps(tree))


def write_forks(folder: Path, experiment: Experiment) -> None:
    """Add the forks of a flight that was changed on its way to its config.toml.

    Raises:
        OSError: it cannot be written.
    """
    path = folder / "config.toml"
    text = path.read_text(encoding="utf-8")
    head = "".join(line for line in text.splitlines(keepends=True) if line.startswith("#"))
    tree = tomllib.loads(text)
    known, made = tree.get("forks", []), dump(experiment)["forks"]
    for fork in made[len(known) :]:  # a user's law is the copy in this folder
        files = {
            key: tree["controller"][key] for key in ("law", "file") if key in fork["controller"]
        }
        known.append({**fork, "controller": {**fork["controller"], **files}})
    write_atomic(path, (head + tomli_w.dumps({**tree, "forks": known})).encode())


def flown_by() -> str:
    """Comment with the date, the code and the libraries of this flight."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    return f"{FLOWN} {now}; code {code_digest()}; board firmware {firmware_id():08x}; {used}\n"


def _keep_law(folder: Path, controller: dict[str, Any]) -> dict[str, Any]:
    """[controller] with the law's file replaced by a copy in the folder."""
    path, kind = None, controller.get("type")
    if kind == "python":
        path = source_of(controller["law"])
    elif kind == "onnx":
        path = Path(controller["file"])
    if path is None:
        return controller
    copy = folder / path.name
    try:
        # an experiment made in Python may name a law without its digest
        expected = controller.get("sha256") or digest(path)
        if copy.exists() and digest(copy) != expected:  # of an earlier fork
            copy = copy.with_stem(f"{path.stem}_{len(list(folder.glob(f'*{path.suffix}'))) + 1}")
        shutil.copyfile(path, copy)
    except OSError as error:
        raise FolderError(f"{path}: {error.strerror}") from None
    controller = {**controller, "sha256": expected}
    if digest(copy) != expected:
        raise FolderError(where=str(path), expected="the law as it was read", found="an edited one")
    if kind == "onnx":
        return {**controller, "file": copy.name}
    if file_of(controller["law"]) is None:
        return controller
    return {**controller, "law": f"{copy.name}:{controller['law'].rpartition(':')[2]}"}


def write_metrics(folder: Path, metrics: Metrics) -> None:
    """Write metrics.json to the run folder."""
    text = msgspec.json.format(msgspec.json.encode(metrics), indent=2).decode()
    _replace(folder / "metrics.json", text + "\n")


def _replace(path: Path, text: str) -> None:
    """Write the file atomically."""
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise FolderError(f"{path}: {error.strerror}") from None
