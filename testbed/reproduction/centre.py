"""gao2022, Table 5: the centre's orbit, from the first column to the others."""

import numpy as np
from msgspec import Struct

from sim_twin.orbit.frames import NADIR
from sim_twin.orbit.gravity import EARTH, POINT_EARTH
from sim_twin.orbit.swarm import fly
from sim_twin.orbit.system import Coast
from testbed.reproduction.figure import Figure
from testbed.reproduction.targets import Measures


class Centre(Struct, frozen=True, forbid_unknown_fields=True, tag="centre"):
    """Columns of the table: time [s], position [km], velocity [km/s]."""

    times: tuple[float, ...]
    positions: tuple[tuple[float, float, float], ...]
    velocities: tuple[tuple[float, float, float], ...]
    j2: bool = True
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not len(self.times) == len(self.positions) == len(self.velocities) >= 2:
            raise ValueError("expected a position and a velocity for each of two or more times")


def run_centre(run: Centre, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Distance of the centre from each column of the table: "gap_km at 1000" and so on."""
    hub = 1e3 * np.concatenate([run.positions[0], run.velocities[0]])
    planet = EARTH if run.j2 else POINT_EARTH
    none = np.zeros((1, 3))
    flight = fly(Coast(), hub, none, none, run.times, axes=NADIR, planet=planet)
    gaps = np.linalg.norm(flight.centre[:, :3] - 1e3 * np.array(run.positions), axis=1) / 1e3
    slips = np.linalg.norm(flight.centre[:, 3:] - 1e3 * np.array(run.velocities), axis=1)
    found = {f"gap_km at {t:.0f}": [float(gap)] for t, gap in zip(run.times, gaps, strict=True)}
    found |= {f"slip_ms at {t:.0f}": [float(s)] for t, s in zip(run.times, slips, strict=True)}
    found["worst_gap_km"] = [float(gaps.max())]
    measures: Measures = dict(found)  # type: ignore[arg-type]
    return measures, []
