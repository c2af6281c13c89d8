"""Reads a vehicle file by name or path, and writes one with the origin of each number."""

from collections.abc import Mapping
from datetime import date
from itertools import chain
from pathlib import Path

from msgspec import structs

from testbed.config.error import ConfigError
from testbed.config.hardware import vehicle_violations
from testbed.config.key import spell
from testbed.config.tree import read_toml
from testbed.core.error import TestbedError
from testbed.core.vehicle import Vehicle
from testbed.identification.mapping import convert, named_file


def load_vehicle(name: str) -> Vehicle:
    """A vehicle given as a file or as the name of a shipped one.

    Raises:
        ConfigError: it is missing or invalid.
    """
    path = named_file(name, "vehicles", "a vehicle file")
    vehicle: Vehicle = convert(read_toml(path), Vehicle, path)  # type: ignore[assignment]
    for key, *texts in vehicle_violations(vehicle):
        raise ConfigError(str(path), spell(key), *texts)
    return vehicle


def write_vehicle(
    path: Path, vehicle: Vehicle, notes: Mapping[str, str], origin: list[str], day: date,
    verb: str = "calibrate motion",
) -> None:  # fmt: skip
    """Write a vehicle file.

    Args:
        path: of the file.
        vehicle: its values.
        notes: comment of a number by its key, such as "mass" or "jets.3".
        origin: lines at the top: logs, hashes, the file that it started from.
        day: today.
        verb: of the command that measured it.

    Raises:
        TestbedError: the path cannot be written.
    """
    lines = [f"# Calibrated on {day.isoformat()} with `testbed {verb}`.", "# From:"]
    lines += [f"#   {line}" for line in origin]
    lines += ["# SI units; times end in _s. Intervals are 95 %.", ""]
    parts = {name: getattr(vehicle, name) for name in vehicle.__struct_fields__}
    tables = [
        n for n, value in parts.items() if n in ("valve", "air", "tolerance", "gauges", "landing")
    ]
    for name, value in parts.items():
        if name == "jets":
            lines.append("jets = [")
            for k, jet in enumerate(value):
                text = (
                    f"  {{ position = {_toml(jet.position)}, push = {_toml(jet.push)}, "
                    f"thrust = {_toml(jet.thrust)} }},"
                )
                lines.append(_with(text, notes.get(f"jets.{k}")))
            lines.append("]")
        elif name not in tables:
            lines.append(_with(f"{name} = {_toml(value)}", notes.get(name)))
    for name in tables:
        lines += ["", f"[{name}]"]
        for key, value in structs.asdict(parts[name]).items():
            lines.append(_with(f"{key} = {_toml(value)}", notes.get(f"{name}.{key}")))
    try:
        path.write_text("\n".join(chain(lines, [""])), encoding="utf-8")
    except OSError as error:
        raise TestbedError(
            where=str(path), expected="a writable path", found=error.strerror or str(error)
        ) from None


def _with(text: str, note: str | None) -> str:
    return f"{text}  # {note}" if note else text


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(float(f"{value:.6g}"))
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return str(value)
