"""`testbed calibrate` and `testbed validate`: from logs to files and figures."""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from testbed.cli.base_table import table_of, tilted
from testbed.cli.exit_code import BAD_INPUT, OK
from testbed.cli.flight_logs import FlightLogs
from testbed.cli.refusal import errors, refuse, warn
from testbed.cli.screen import print_json, print_text
from testbed.cli.steps import Steps
from testbed.core.error import TestbedError
from testbed.core.vehicle import Vehicle
from testbed.identification.calibration_file import report_of, save
from testbed.identification.cameras import latency_of, seen_in_flight
from testbed.identification.columns import LogRefusedError, digest, read_columns, read_sources
from testbed.identification.excite import design, write_commands
from testbed.identification.link import link_of
from testbed.identification.mapping import check_valves, load_mapping
from testbed.identification.motion import (
    calibrate_motion,
    doubts_about,
)
from testbed.identification.motion_log import MotionLog, read_motion_log
from testbed.identification.own_run import read_run_log
from testbed.identification.slope_map import measured_map, write_slope_page
from testbed.identification.table_file import load_table, write_table
from testbed.identification.thrust_stand import thrust_of
from testbed.identification.validation import validate
from testbed.identification.validation_page import write_page
from testbed.identification.vehicle_file import load_vehicle

# of numbers without a unit: of all jets' thrust, and of what it loses per further open jet
UNITS = {"thrust": "x file's", "droop": "per jet"}

screen = Console(highlight=False, soft_wrap=True)


def today() -> Any:
    """The date, for the head of a file."""
    return datetime.now(UTC).date()  # noqa: TID251  (a file is dated)


def refused(error: TestbedError, *, as_json: bool) -> int:
    """Report a refusal, also as JSON."""
    if as_json:
        found = getattr(error, "suspicions", None)
        print_json({
            "refused": True, "where": error.where, "found": error.found or str(error),
            "expected": error.expected, "hint": error.hint,
            "suspicions": [{"name": s.name, "text": s.text} for s in found or []],
        })  # fmt: skip
    return refuse(error, BAD_INPUT)


def is_run(path: Path, mapping: str | None) -> bool:
    """Whether a log is one of our runs, which needs no mapping."""
    return path.is_dir() or (mapping is None and path.suffix.lower() == ".mcap")


def check_outputs(*paths: Path | None) -> None:
    """Check, before the work, that files can be written there.

    Raises:
        TestbedError: the folder of one is missing.
    """
    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise TestbedError(
                where=str(path), expected="a file in a folder that exists",
                found=f"no folder {path.parent}",
            )  # fmt: skip


def warn_of_second_use(vehicle: str, logs: Sequence[MotionLog]) -> None:
    """Warn of logs that a vehicle file was fitted to: they would count twice."""
    warn([
        f"{log.where}: {vehicle} was fitted to this log already; its intervals will be too narrow."
        " Begin with the file before that fit"
        for log in logs if _knows(vehicle, log)
    ])  # fmt: skip


def read_logs(given: FlightLogs, progress: Callable[[str], None]) -> list[MotionLog]:
    """Read logs or run folders; rows outside the given time are marked as not whole."""
    paths, mapping, body, since, until = given
    logs = []
    for path in paths:
        progress(f"read {path}")
        if is_run(path, mapping):
            log = read_run_log(path, body)
        elif mapping is None:
            raise TestbedError(
                where="--mapping", expected="a mapping for a log that is no run folder",
                found="nothing",
                hint="shipped: ita, spot, uky; docs/calibrate.md shows how to write one",
            )  # fmt: skip
        else:
            log = read_motion_log(path, load_mapping(mapping))
        whole = log.whole.copy()
        if since is not None:
            whole &= log.t >= since
        if until is not None:
            whole &= log.t < until
        if log.whole.any() and not whole.any():
            raise TestbedError(
                where=f"{path}, --from and --until", expected="a part of the log's flight",
                found=f"flight from {log.t[log.whole][0]:.3f} to {log.t[log.whole][-1]:.3f} s",
            )  # fmt: skip
        logs.append(log._replace(whole=whole))
    return logs


def vehicles_of(mapping: str | None) -> dict[str, Vehicle]:
    """The lab's vehicles, which the mapping names; none without a mapping."""
    return {name: load_vehicle(name) for name in load_mapping(mapping).vehicles} if mapping else {}


def motion(
    given: FlightLogs, vehicle: str, out: Path | None, table_out: Path | None, *, force: bool,
    as_json: bool,
) -> int:  # fmt: skip
    """Fit a vehicle and write its file, and the slope of the table."""
    try:
        check_outputs(out, table_out)
        check_valves(given.mapping, load_vehicle(vehicle))
        with Steps(errors, silent=as_json) as progress:
            logs = read_logs(given, progress)
            warn_of_second_use(vehicle, logs)
            found = calibrate_motion(
                logs, load_vehicle(vehicle), others=vehicles_of(given.mapping), force=force,
                progress=progress,
            )  # fmt: skip
        if out is not None:
            save(out, found, vehicle, logs, today())
        if table_out is not None:
            slope = [float(found.estimate.p[found.model.index(a)]) for a in ("slope_x", "slope_y")]
            origin = [f"{Path(log.where).name}, sha256 {log.digest}" for log in logs]
            write_table(
                table_out, tilted(table_of(given.paths, given.mapping), slope), origin, today()
            )
    except TestbedError as error:
        return refused(error, as_json=as_json)
    result = report_of(found, vehicle, logs) | {"out": None if out is None else str(out)}
    if as_json:
        print_json(result)
        return OK
    warn([note for log in logs for note in log.notes])
    warn([f"{one['name']}: {one['text']}" for one in result["suspicions"]])
    if result["kept"]:
        warn([f"not identifiable, kept as in {vehicle}: {', '.join(result['kept'])}"])
    for name, row in result["parameters"].items():
        kept = "" if row["chosen"] else "  kept as in the file"
        note = "" if row["identifiable"] else "  not identifiable from this log"
        print_text(
            screen,
            f"{name:<10} {row['value']:>10.4g} {UNITS.get(name, row['unit']):<9}"
            f" 95 %: {row['low']:.4g} to {row['high']:.4g}{kept}{note}",
        )
    for row in result["jets"]:
        note = "" if row["identifiable"] else "  not identifiable from this log"
        kept = "  kept as in the file" if row["kept"] else ""
        if not (row["fitted"] or row["kept"] or row["identifiable"]):
            kept = "  the file's times the common thrust"
        print_text(
            screen,
            f"jet {row['jet']:<6} {row['thrust_n']:>10.4g} N         95 %: {row['low_n']:.4g} to"
            f" {row['high_n']:.4g}  {row['state']}{kept}{note}",
        )
    for line in result["findings"]:
        print_text(screen, line, "bold")
    return OK


def check_against(
    given: FlightLogs, vehicle: str, against: str | None, table: str | None, out: Path | None, *,
    as_json: bool,
) -> int:  # fmt: skip
    """Predict logs and print how far off the twin is."""
    try:
        check_outputs(out)
        own = load_vehicle(vehicle)
        check_valves(given.mapping, own)
        with Steps(errors, silent=as_json) as progress:
            logs = read_logs(given, progress)
            other = load_vehicle(against) if against else None
            surface = load_table(table) if table else None
            doubts = doubts_about(logs, own, vehicles_of(given.mapping), progress)
            progress("predict the logs")
            result, by_horizon = validate(logs, own, other, surface)
        seen = [log.where for log in logs if _knows(vehicle, log)]
        result |= {
            "files": {"vehicle": vehicle, "against": against, "table": table},
            "suspicions": [{"name": s.name, "text": s.text} for s in doubts],
            "seen_by_the_fit": seen,
        }
        if any(one.name == "other-vehicle" for one in doubts):
            result["verdict"] = f"Perhaps another vehicle's log. {result['verdict']}"
        if out is not None:
            write_page(out, f"Validation of {vehicle}", result, by_horizon)
    except TestbedError as error:
        return refused(error, as_json=as_json)
    if as_json:
        print_json(result)
        return OK
    warn([note for log in logs for note in log.notes])
    warn([f"{one['name']}: {one['text']}" for one in result["suspicions"]])
    warn([f"{name}: the fit has seen this log" for name in seen])
    for h, both in result["horizons"].items():
        for who, one in both.items():
            if one["count"]:
                print_text(
                    screen,
                    f"{h} s ahead, {vehicle if who == 'vehicle' else against}:"
                    f" {1e3 * one['position_rms_m']:.1f} mm RMS,"
                    f" {1e3 * one['position_median_m']:.1f} mm median,"
                    f" {one['heading_rms_deg']:.2f} deg RMS, {one['count']} predictions",
                )
    print_text(screen, result["verdict"])
    return OK


def _knows(vehicle: str, log: MotionLog) -> bool:
    """Whether the vehicle file says that it was fitted to this part of the log."""
    path, t = Path(vehicle), log.t[log.whole]
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    for line in text.splitlines():
        if log.digest in line and len(t):
            part = re.search(r"t = (\S+) to (\S+) s", line)
            if part is None or (t[-1] > float(part[1]) and t[0] < float(part[2])):
                return True
    return False


def slope(
    path: Path, columns: tuple[str, str, str, str], unit: str, out: Path | None,
    drawn: Path | None, *, as_json: bool,
) -> int:  # fmt: skip
    """Read a measured slope map; write it as a table file and a page."""
    try:
        surface = measured_map(read_columns(path, columns), columns, unit)
        if out is not None:
            write_table(out, surface, [f"{path.name}, sha256 {digest(path)}"], today())
        if drawn is not None:
            write_slope_page(drawn, f"Slope of {path.name}", surface)
    except TestbedError as error:
        return refused(error, as_json=as_json)
    grid = surface.tilt.map
    largest = max(max(abs(a), abs(b)) for row in grid for a, b in row)
    result = {"size_m": list(surface.size), "nodes": [len(grid[0]), len(grid)],
              "largest_m_s2": largest, "out": None if out is None else str(out)}  # fmt: skip
    if as_json:
        print_json(result)
        return OK
    print_text(
        screen,
        f"{len(grid[0])} x {len(grid)} nodes on {surface.size[0]:g} m x {surface.size[1]:g} m,"
        f" at most {1e3 * largest:.1f} mm/s^2",
    )
    return OK


def thrust(paths: Sequence[Path], columns: tuple[str, str, str], unit: str, as_json: bool) -> int:
    """Thrust of each stand log."""
    rows = []
    try:
        for path in paths:
            rows.append({"file": str(path)} | thrust_of(
                read_columns(path, columns), columns[0], columns[1], unit, columns[2]
            ))  # fmt: skip
    except TestbedError as error:
        return refused(error, as_json=as_json)
    if as_json:
        print_json({"jets": rows})
        return OK
    for row in rows:
        print_text(
            screen,
            f"{row['file']}: {row['thrust_n']:.4f} N (95 %: {row['low_n']:.4f} to"
            f" {row['high_n']:.4f}), {row['pulses']} pulses, spread {row['pulse_spread']:.2%},"
            f" change over the run {row['change']:+.1%}",
        )
    return OK


def mocap(
    path: Path, mapping: str | None, body: str | None, vehicle: str | None,
    columns: tuple[str, str, str], camera: str, *, force: bool, as_json: bool,
) -> int:  # fmt: skip
    """Latency from a marker on a known angle; or noise, axes and body offset from a flight."""
    try:
        if mapping is None and not is_run(path, mapping):
            sources = read_sources(path, *columns)
            others = [name for name in sources if name != camera]
            if camera not in sources or len(others) != 1:
                raise LogRefusedError(
                    where=str(path), expected=f"two sources, one of them {camera!r}",
                    found=", ".join(map(repr, sources)),
                )  # fmt: skip
            truth, seen = sources[others[0]], sources[camera]
            result = latency_of(truth[:, 0], truth[:, 1], seen[:, 0], seen[:, 1], str(path))
        else:
            if vehicle is None:
                raise TestbedError(where="--vehicle", expected="a vehicle", found="nothing")
            own = load_vehicle(vehicle)
            check_valves(mapping, own)
            with Steps(errors, silent=as_json) as progress:
                (log,) = read_logs(FlightLogs([path], mapping, body, None, None), progress)
                found = calibrate_motion(
                    [log], own, others=vehicles_of(mapping), force=force, progress=progress
                )
            result = seen_in_flight(log, found)
            if not as_json:
                warn([f"{one.name}: {one.text}" for one in found.suspicions])
    except TestbedError as error:
        return refused(error, as_json=as_json)
    if as_json:
        print_json(result)
        return OK
    for name, value in result.items():
        shown = f"{value:.6g}" if isinstance(value, float) else value
        if isinstance(value, dict):
            note = "" if value["identifiable"] else "  not identifiable from this log"
            shown = f"{value['value']:.4g} {value['unit']}"
            shown += f"  95 %: {value['low']:.4g} to {value['high']:.4g}{note}"
        print_text(screen, f"{name:<22} {shown}")
    return OK


def link(path: Path, columns: tuple[str, str], as_json: bool) -> int:
    """Numbers of [link] from sent and received messages."""
    try:
        result = link_of(read_columns(path, columns), *columns)
    except TestbedError as error:
        return refused(error, as_json=as_json)
    if as_json:
        print_json(result)
        return OK
    screen.print("[link]", markup=False)
    for name, value in result.items():
        screen.print(f"{name} = {value:.4g}")
    return OK


def excite(
    vehicle: str, table: str, seconds: float, room: float, gas_g: float | None, period: float,
    seed: int, out: Path | None, *, as_json: bool,
) -> int:  # fmt: skip
    """Design an experiment and write its commands."""
    try:
        check_outputs(out)
        own = load_vehicle(vehicle)
        gas = None if gas_g is None else 1e-3 * gas_g
        found = design(own, load_table(table), seconds, room, gas, period, seed)
        if out is not None:
            write_commands(out, found, len(own.jets), period)
    except TestbedError as error:
        return refused(error, as_json=as_json)
    result = {
        "seconds": seconds, "gas_g": 1e3 * found.gas, "reach_m": found.reach,
        "information": found.information, "parameters": found.intervals,
        "pulses": len(found.inputs.up), "out": None if out is None else str(out),
    }  # fmt: skip
    if as_json:
        print_json(result)
        return OK
    print_text(
        screen,
        f"{len(found.inputs.up)} pulses, {1e3 * found.gas:.1f} g of gas, at most"
        f" {found.reach:.2f} m from the start",
    )
    for name, row in found.intervals.items():
        note = "" if row["identifiable"] else "  not identifiable"
        screen.print(f"{name:<16} +- {row['half_width']:.3g} {row['unit']}{note}")
    return OK
