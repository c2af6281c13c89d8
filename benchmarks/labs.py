"""Vehicles and cameras of other labs, drawn at random, for `--labs` of healthy.py and diagnoses.py.

`ring`: pairs of jets all round the body, each pair pushing inwards with opposite torques. `wild`:
jets anywhere, pushing anywhere. Lab k of a seed is always the same one.
"""

from typing import Any

import numpy as np

from testbed.config import ConfigError, find, load
from testbed.flight.allocation import weakest_force

LAYOUTS = "ring", "wild"
TRIES = 200
WEAKEST = 0.4  # of one jet: force that a drawn layout must have in its weakest direction


def lab(layout: str, seed: int, number: int) -> list[str]:
    """What differs from the shipped vehicle, table and cameras, as for `testbed run`."""
    rng = np.random.default_rng([seed, LAYOUTS.index(layout), number])
    for _ in range(TRIES):
        words = _draw(rng, layout)
        try:
            model = load(find("hold"), words).vehicles["sat1"].model
        except ConfigError:
            continue
        if weakest_force(model) > WEAKEST * min(jet.thrust for jet in model.jets):
            return words
    raise RuntimeError(f"No layout in {TRIES} tries: {layout}, seed {seed}, number {number}")


def _draw(rng: np.random.Generator, layout: str) -> list[str]:
    mass = float(np.exp(rng.uniform(np.log(4.0), np.log(50.0))))
    radius = 0.08 * mass ** (1.0 / 3.0)
    thrust = 0.5 * mass * rng.uniform(0.05, 0.12)  # [N] two jets push a mass at 0.05 to 0.12 m/s^2
    opens = rng.uniform(0.005, 0.03)
    slope, way = rng.uniform(0.0, 0.004), rng.uniform(0.0, 2.0 * np.pi)
    model = "vehicles.*.model"
    numbers = {
        f"{model}.mass": mass,
        f"{model}.inertia": mass * (radius * rng.uniform(0.5, 0.8)) ** 2,
        f"{model}.radius": radius,
        f"{model}.valve.open_delay_s": opens,
        f"{model}.valve.close_delay_s": opens * rng.uniform(0.7, 1.2),
        f"{model}.valve.min_on_s": rng.uniform(0.005, 0.02),
        f"{model}.air.droop": rng.uniform(0.0, 0.2) if rng.random() < 0.5 else 0.0,
        f"{model}.tolerance.thrust": rng.uniform(0.02, 0.1),
        f"{model}.tolerance.direction_deg": rng.uniform(0.3, 2.0),
        "table.mocap.rate_hz": rng.choice([50.0, 100.0, 120.0, 200.0]),
        "table.mocap.noise": 1e-3 * rng.uniform(0.1, 0.5),
    }
    jets = (_ring if layout == "ring" else _wild)(rng, radius, thrust)
    return [
        *(f"{key}={value:.6g}" for key, value in numbers.items()),
        f"{model}.com=[{rng.normal(0.0, 0.003):.4g},{rng.normal(0.0, 0.003):.4g}]",
        f"{model}.jets=[{','.join(jets)}]",
        f"table.tilt.uniform=[{slope * np.cos(way):.4g},{slope * np.sin(way):.4g}]",
    ]


def _ring(rng: Any, radius: float, thrust: float) -> list[str]:
    pairs, first, aside = int(rng.integers(3, 7)), rng.uniform(0.0, np.pi), rng.uniform(0.4, 0.9)
    jets = []
    for at in first + 2.0 * np.pi * np.arange(pairs) / pairs:
        for side in (-1.0, 1.0):
            place = 0.8 * radius * np.array([np.cos(at), np.sin(at)])
            towards = at + np.pi + side * aside
            jets.append(_jet(place, towards, thrust))
    return jets


def _wild(rng: Any, radius: float, thrust: float) -> list[str]:
    jets = []
    for _ in range(int(rng.integers(6, 11))):
        at, out = rng.uniform(0.0, 2.0 * np.pi), radius * rng.uniform(0.4, 0.95)
        place = out * np.array([np.cos(at), np.sin(at)])
        jets.append(_jet(place, rng.uniform(0.0, 2.0 * np.pi), thrust * rng.uniform(0.6, 1.4)))
    return jets


def _jet(place: Any, towards: float, thrust: float) -> str:
    return (
        f"{{position=[{place[0]:.5f},{place[1]:.5f}],"
        f"push=[{np.cos(towards):.6f},{np.sin(towards):.6f}],thrust={thrust:.4g}}}"
    )
