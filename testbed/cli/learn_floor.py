"""`testbed calibrate floor`: from logs to a table file with a slope map, and its vehicle."""

from pathlib import Path
from typing import Any

from testbed.cli.base_table import table_of
from testbed.cli.calibrate import (
    check_outputs,
    read_logs,
    refused,
    screen,
    today,
    vehicles_of,
    warn_of_second_use,
)
from testbed.cli.exit_code import OK
from testbed.cli.flight_logs import FlightLogs
from testbed.cli.refusal import errors, warn
from testbed.cli.screen import print_json, print_text
from testbed.cli.steps import Steps
from testbed.core.error import TestbedError
from testbed.identification.calibration_file import save_with_map
from testbed.identification.floor import check_path, flat_fit, learn_floor
from testbed.identification.mapping import check_valves, load_mapping
from testbed.identification.motion import admitted
from testbed.identification.slope_map import with_map, write_slope_page
from testbed.identification.table_file import load_table, write_table
from testbed.identification.vehicle_file import load_vehicle


def floor(
    given: FlightLogs, vehicle: str, table: str | None, size: tuple[float, float] | None,
    nodes: int, out: Path | None, vehicle_out: Path | None, drawn: Path | None, *,
    force: bool, as_json: bool,
) -> int:  # fmt: skip
    """Learn the slope map; write it as a table file, its vehicle and a page."""
    try:
        check_outputs(out, vehicle_out, drawn)
        own = load_vehicle(vehicle)
        check_valves(given.mapping, own)
        with Steps(errors, silent=as_json) as progress:
            logs = read_logs(given, progress)
            warn_of_second_use(vehicle, logs)
            stated = table or (size and given.mapping)  # else the size may have to be guessed
            base = load_table(table) if stated else table_of(given.paths, given.mapping)
            named = load_mapping(given.mapping).table if given.mapping else None
            span = size or named or base.size
            check_path(logs, span)
            doubts = admitted(logs, own, vehicles_of(given.mapping), progress, force=force)
            progress("learn the slope map")
            found = learn_floor(logs, own, (float(span[0]), float(span[1])), nodes)
            progress("fit on a level table, to compare")
            model, p = flat_fit(logs, own)
        surface = with_map(base, found.slope, found.size)
        origin = [f"{Path(log.where).name}, sha256 {log.digest}" for log in logs]
        if out is not None:
            write_table(out, surface, origin, today())
        if vehicle_out is not None:
            save_with_map(vehicle_out, found, vehicle, origin, today())
        if drawn is not None:
            write_slope_page(drawn, "Slope learned from flights", surface, found.sigma)
    except TestbedError as error:
        return refused(error, as_json=as_json)
    known = found.sigma.min(axis=2) < 0.5 * float(found.sigma.max())
    result = {
        "size_m": list(found.size), "nodes": nodes, "map": found.slope.tolist(),
        "sigma": found.sigma.tolist(), "known_share": float(known.mean()),
        "largest_m_s2": float(largest(found.slope, known)), "reach_m": found.reach,
        "thrust_or_mass": float(found.p[0]), "delay_s": float(found.p[found.model.index("delay")]),
        "without_map": {"thrust_or_mass": float(p[0]), "delay_s": float(p[model.index("delay")])},
        "suspicions": [{"name": one.name, "text": one.text} for one in doubts],
        "out": None if out is None else str(out),
    }  # fmt: skip
    if as_json:
        print_json(result)
        return OK
    warn([note for log in logs for note in log.notes])
    warn([f"{one.name}: {one.text}" for one in doubts])
    print_text(
        screen,
        f"slope map of {nodes} x {nodes} nodes over {span[0]:g} m x {span[1]:g} m;"
        f" {100 * result['known_share']:.0f} % of them are told by the logs, at most"
        f" {1e3 * result['largest_m_s2']:.1f} mm/s^2 there",
    )
    return OK


def largest(slope: Any, known: Any) -> float:
    """Largest slope at known nodes [m/s^2]."""
    return float(abs(slope[known]).max()) if known.any() else 0.0
