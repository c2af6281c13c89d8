"""An experiment file and all it refers to, read into typed frozen structs.

One TOML per experiment, vehicle and table. A `table` or a vehicle's `model` is a path, relative to
the file that says so, or the table itself written in place; the resolved experiment has everything
in place and is a file of the same form. `key=value` overrides are TOML too; `*` in a key stands for
every entry.

Whatever is wrong is one `ConfigError` that says where, what was expected and what was found.
"""

import difflib
import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from msgspec import Struct, field

from controllers.catalogue import Controller, make_law
from testbed.core.jets import effect_matrix
from testbed.core.table import Obstacle, Table
from testbed.core.types import Pose
from testbed.core.vehicle import Positive, Vehicle
from testbed.flight.agent import FlightParams
from testbed.flight.guidance import GuidanceParams
from testbed.ops.metrics import Criteria

SHIPPED = Path(__file__).resolve().parent.parent / "configs"


class VehicleSetup(Struct, frozen=True, forbid_unknown_fields=True):
    """One vehicle of an experiment."""

    model: Vehicle
    start: tuple[float, float, float]  # x, y [m], theta [rad]
    goal: tuple[float, float, float]


class Deploy(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the halves run."""

    law: Literal["host", "vehicle"] = "host"


class Experiment(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything a run depends on."""

    name: str
    duration_s: Positive
    table: Table
    vehicles: dict[str, VehicleSetup]
    controller: Controller
    description: str = ""
    seed: int = 0
    obstacles: dict[str, Obstacle] = field(default_factory=dict)
    guidance: GuidanceParams = field(default_factory=GuidanceParams)
    flight: FlightParams = field(default_factory=FlightParams)
    deploy: Deploy = field(default_factory=Deploy)
    criteria: Criteria = field(default_factory=Criteria)

    @property
    def ticks(self) -> int:
        """Jet periods in the run."""
        return max(1, round(self.duration_s / self.flight.jet_period_s))


class ConfigError(Exception):
    """Something in the input is wrong; says where, what was expected and what was found."""

    def __init__(self, where: str, key: str, expected: str, found: str) -> None:
        self.where, self.key, self.expected, self.found = where, key, expected, found
        lines = [where] + [f"  key       {key}"] * bool(key)
        super().__init__("\n".join([*lines, f"  expected  {expected}", f"  found     {found}"]))


class _Source:
    """The tree while it is put together, and where each part of it came from."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.tree = read_toml(path)
        self._files: dict[str, Path] = {}  # key prefix -> the file it was included from
        self._typed: dict[str, str] = {}  # key -> override on the command line
        self._include(path.parent)

    def _include(self, folder: Path) -> None:
        slots: list[tuple[dict[str, Any], str, str]] = [(self.tree, "table", "table")]
        vehicles = self.tree.get("vehicles")
        if isinstance(vehicles, dict):
            slots += [
                (entry, "model", f"vehicles.{name}.model")
                for name, entry in vehicles.items()
                if isinstance(entry, dict)
            ]
        for parent, key, path in slots:
            if isinstance(parent.get(key), str):
                file = folder / parent[key]
                if not file.is_file():
                    raise ConfigError(
                        *self.locate(path), "the path of an existing file", f"{parent[key]!r}"
                    )
                parent[key] = read_toml(file)
                self._files[path] = file

    def override(self, text: str) -> None:
        key, equals, raw = text.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ConfigError("command line", "", "key=value", repr(text))
        value = _parse_value(key, raw.strip())
        parents = [("", self.tree)]
        *inner, last = key.split(".")
        for part in inner:
            parents = [
                (f"{path}.{name}".lstrip("."), parent.setdefault(name, {}))
                for path, parent in parents
                for name in (list(parent) if part == "*" else [part])
            ]
            for path, parent in parents:
                if not isinstance(parent, dict):
                    raise ConfigError("command line", key, f"a table at {path}", f"{_show(parent)}")
        for path, parent in parents:
            for name in list(parent) if last == "*" else [last]:
                parent[name] = value
                self._typed[f"{path}.{name}".lstrip(".")] = text
        self._include(Path())

    def locate(self, key: str) -> tuple[str, str]:
        """Where a key of the tree was written, and its name there."""
        for typed, text in self._typed.items():
            if key == typed or key.startswith((typed + ".", typed + "[")):
                return f"command line: {text}", key
        for prefix, file in self._files.items():
            if key.startswith(prefix + "."):
                return str(file), key.removeprefix(prefix + ".")
        return str(self.path), key


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a tree of tables."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), "", "a readable file", error.strerror or str(error)) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), "", "a TOML file", str(error)) from None


def _parse_value(key: str, raw: str) -> Any:
    try:
        return tomllib.loads(f"value = {raw}")["value"]
    except tomllib.TOMLDecodeError:
        if re.fullmatch(r"[A-Za-z_][\w./-]*", raw):  # a bare word is a string
            return raw
        raise ConfigError("command line", key, "a TOML value", repr(raw)) from None


def _show(value: object) -> str:
    text = repr(value)
    return text if len(text) < 80 else text[:77] + "..."


def find(name: str) -> Path:
    """The file of an experiment given as a path or as the name of a shipped one."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = SHIPPED / "experiments" / f"{name}.toml"
    if shipped.is_file():
        return shipped
    known = sorted(p.stem for p in (SHIPPED / "experiments").glob("*.toml"))
    close = difflib.get_close_matches(Path(name).stem, known, n=1)
    hint = f" (did you mean {close[0]}?)" if close else ""
    raise ConfigError(
        name, "", f"an experiment file or one of: {', '.join(known)}", f"no such file{hint}"
    )


def load(path: Path, overrides: Sequence[str] = ()) -> Experiment:
    """Read, complete and check an experiment.

    Args:
        path: of the experiment's TOML.
        overrides: "key=value", applied in order.

    Raises:
        ConfigError: something is wrong.
    """
    source = _Source(path)
    for text in overrides:
        source.override(text)
    for key, value in _leaves(source.tree):
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(*source.locate(key), "a finite number", str(value))
    experiment = _convert(source)
    for key, expected, found in _mistakes(experiment):
        raise ConfigError(*source.locate(key), expected, found)
    return experiment


def dump(experiment: Experiment) -> dict[str, Any]:
    """The experiment as a tree that `tomli_w` can write and `load` can read."""

    def drop_none(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: drop_none(v) for k, v in value.items() if v is not None}
        if isinstance(value, list | tuple):
            return [drop_none(v) for v in value]
        return value

    return drop_none(msgspec.to_builtins(experiment))


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{path}[{i}]")
    else:
        yield path, value


def _convert(source: _Source) -> Experiment:
    try:
        return msgspec.convert(source.tree, Experiment)
    except msgspec.ValidationError as error:
        message, _, at = str(error).partition(" - at `$")
        key = _sharpen(source.tree, str(error), at.rstrip("`"))
        raise _explain(source, message, key.lstrip(".")) from None


def _sharpen(tree: dict[str, Any], error: str, path: str) -> str:
    """Put names and numbers for the `[...]` of msgspec's path, by leaving entries out."""
    while "[...]" in path:
        head, _, tail = path.partition("[...]")
        node: Any = tree
        for part in re.findall(r"[^.\[\]]+", head):
            node = node[int(part)] if isinstance(node, list) else node[part]
        named = None
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            kept = node[key]
            if not isinstance(kept, dict):
                break
            alone: Any = {key: kept} if isinstance(node, dict) else [kept]
            if _fails(_replaced(tree, head, alone), error):
                named = f"{head}.{key}" if isinstance(node, dict) else f"{head}[{key}]"
                break
        if named is None:
            return head
        path = named + tail
    return path


def _replaced(tree: Any, path: str, value: Any) -> Any:
    parts = re.findall(r"[^.\[\]]+", path)
    if not parts:
        return value
    head, rest = parts[0], ".".join(parts[1:])
    if isinstance(tree, list):
        return [_replaced(v, rest, value) if i == int(head) else v for i, v in enumerate(tree)]
    return {k: _replaced(v, rest, value) if k == head else v for k, v in tree.items()}


def _fails(tree: Any, error: str) -> bool:
    try:
        msgspec.convert(tree, Experiment)
    except msgspec.ValidationError as again:
        return str(again) == error
    return False


def _explain(source: _Source, message: str, key: str) -> ConfigError:
    node: Any = source.tree
    for part in re.findall(r"[^.\[\]]+", key):
        node = node[int(part)] if isinstance(node, list) else node[part]
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", message):
        name = unknown[1]
        known = _known_keys(key, node)
        close = difflib.get_close_matches(name, known, n=1)
        hint = f" (did you mean `{close[0]}`?)" if close else ""
        path = f"{key}.{name}".lstrip(".")
        return ConfigError(
            *source.locate(path), f"one of: {', '.join(known)}", f"unknown key `{name}`{hint}"
        )
    if missing := re.fullmatch(r"Object missing required field `(.*)`", message):
        path = f"{key}.{missing[1]}".lstrip(".")
        return ConfigError(*source.locate(path), "a value", "nothing: the key is missing")
    if tag := re.fullmatch(r"Invalid value '?(.*?)'?", message):
        return ConfigError(*source.locate(key), f"one of: {_tags(key)}", f"{tag[1]!r}")
    expected = re.sub(r"^Expected ", "", message).partition(", got ")[0].replace("`", "")
    return ConfigError(*source.locate(key), expected, _show(node))


def _struct_at(key: str, node: Any) -> type[Struct] | None:
    """The struct that a key of the tree is converted to."""
    kind: Any = Experiment
    for part in re.findall(r"[^.\[\]]+", key):
        if isinstance(kind, type) and issubclass(kind, Struct):
            kind = {f.encode_name: f.type for f in msgspec.structs.fields(kind)}.get(part)
        else:  # an entry of a dict or list
            kind = get_args(kind)[-1]
    options = [
        k for k in (get_args(kind) or (kind,)) if isinstance(k, type) and issubclass(k, Struct)
    ]
    if len(options) > 1 and isinstance(node, dict):
        options = [k for k in options if k.__struct_config__.tag == node.get("type")]
    return options[0] if options else None


def _known_keys(key: str, node: Any) -> list[str]:
    kind = _struct_at(key, node)
    return sorted(f.encode_name for f in msgspec.structs.fields(kind)) if kind else []


def _tags(key: str) -> str:
    unions = {"controller.type": Controller, "flight.modulator.type": FlightParams}
    union = unions.get(key)
    if union is FlightParams:
        union = FlightParams.__annotations__["modulator"]
    return ", ".join(str(k.__struct_config__.tag) for k in get_args(union)) or "the allowed values"


def _mistakes(experiment: Experiment) -> Iterator[tuple[str, str, str]]:
    """What the types cannot say: (key, expected, found)."""
    half_x, half_y = experiment.table.size[0] / 2, experiment.table.size[1] / 2
    if not re.fullmatch(r"[\w.-]+", experiment.name):
        yield "name", "letters, digits, `_`, `-`, `.`", repr(experiment.name)
    if not experiment.vehicles:
        yield "vehicles", "at least one vehicle", "none"
    for name, setup in experiment.vehicles.items():
        if not re.fullmatch(r"[\w-]+", name):
            yield f"vehicles.{name}", "a name of letters, digits, `_`, `-`", repr(name)
        for which, pose in (("start", setup.start), ("goal", setup.goal)):
            key, radius = f"vehicles.{name}.{which}", setup.model.radius
            if abs(pose[0]) > half_x - radius or abs(pose[1]) > half_y - radius:
                room = f"|x| <= {half_x - radius:g} m and |y| <= {half_y - radius:g} m"
                yield key, f"a place on the table: {room}", f"({pose[0]:g}, {pose[1]:g})"
            for other, rock in experiment.obstacles.items():
                gap = math.dist(pose[:2], rock.position)
                if gap < rock.radius:
                    found = f"{gap:.3f} m (radius of {other}: {rock.radius:g} m)"
                    yield key, f"outside obstacle {other}", found
        yield from _vehicle_mistakes(f"vehicles.{name}.model", setup.model, experiment)
    for (a, one), (b, two) in combinations(experiment.vehicles.items(), 2):
        for which in ("start", "goal"):
            gap = math.dist(getattr(one, which)[:2], getattr(two, which)[:2])
            reach = one.model.radius + two.model.radius
            if gap < reach:
                key = f"vehicles.{b}.{which}"
                yield key, f"at least {reach:g} m from {a}'s {which}", f"{gap:.3f} m: they overlap"
    for name, rock in experiment.obstacles.items():
        if rock.solid > rock.radius:
            key = f"obstacles.{name}.solid"
            yield key, f"at most the danger radius, {rock.radius:g} m", f"{rock.solid:g} m"
    rows = {len(row) for row in experiment.table.tilt.map}
    if len(rows) > 1 or 0 in rows:
        yield "table.tilt.map", "rows of equal length", f"lengths {sorted(rows)}"
    try:
        make_law(experiment.controller)
    except ValueError as error:
        yield "controller", "parameters that fit a plane", str(error)


def _vehicle_mistakes(
    key: str, vehicle: Vehicle, experiment: Experiment
) -> Iterator[tuple[str, str, str]]:
    for i, jet in enumerate(vehicle.jets):
        if abs(math.hypot(*jet.push) - 1.0) > 1e-6:
            yield f"{key}.jets[{i}].push", "a unit vector", str(list(jet.push))
    effect = effect_matrix(vehicle.jets, about=vehicle.com)
    if not _pushes_everywhere(effect):
        yield (
            f"{key}.jets",
            "jets that push and turn the body every way",
            f"{len(vehicle.jets)} that do not",
        )
    period, valve = experiment.flight.jet_period_s, vehicle.valve
    if valve.min_on_s > period:
        yield "flight.jet_period_s", f"at least min_on_s, {valve.min_on_s:g} s", f"{period:g} s"
    if vehicle.air.gas >= vehicle.mass:
        yield (
            f"{key}.air.gas",
            f"less than the mass, {vehicle.mass:g} kg",
            f"{vehicle.air.gas:g} kg",
        )
    if vehicle.command_delay_s >= period:
        yield (
            f"{key}.command_delay_s",
            f"less than the jet period, {period:g} s",
            f"{vehicle.command_delay_s:g} s",
        )


def _pushes_everywhere(effect: np.ndarray) -> bool:
    """Whether non-negative combinations of the columns, shape (3, n), reach every wrench."""
    from scipy.optimize import nnls

    if effect.shape[1] == 0:
        return False
    scaled = effect / np.maximum(np.abs(effect).max(axis=1, keepdims=True), 1e-12)
    return all(nnls(scaled, sign * axis)[1] < 1e-9 for axis in np.eye(3) for sign in (1.0, -1.0))


def pose(values: tuple[float, float, float]) -> Pose:
    """[x, y, theta] of a file."""
    return Pose(*values)
