"""Bounds of the fault table in terms of the vehicles, the table and the links.

`above` and `below` of configs/faults.toml may be arithmetic of the words below, with + - * / ( ),
min and max. It is worked out when an experiment is loaded; the experiment has plain numbers.
"""

import ast
import math
import operator
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from testbed.config.error import Violation, show
from testbed.config.number import LARGEST
from testbed.core.table import Link, Table
from testbed.core.vehicle import Vehicle
from testbed.flight.allocation import weakest_force
from testbed.flight.estimator import EstimatorParams
from testbed.flight.faults import FaultTable
from testbed.flight.guidance import GuidanceParams
from testbed.flight.parameters import SPARE_FORCE, FlightParams

WORDS = {
    "frame": "time between two camera frames [s]",
    "latency": "of the cameras [s]",
    "jitter": "of that, one sigma [s]",
    "noise": "of a pose, one sigma [m]",
    "period": "jet period [s]",
    "push": "largest acceleration by the jets [m/s^2]",
    "top_speed": "flight.barrier.max_speed [m/s]",
    "stop_s": "to stop from there with all jets [s]",
    "blind_s": "for which a prediction without poses stays within the room that is kept [s]",
    "planned_s": "for which the newest setpoint is valid: preview and life [s]",
    "silence_s": "silence of a healthy link, once in 10^8 messages [s]",
    "gas_use": "share of the tank per second with half the jets open, and the bearings [1/s]",
    "undervoltage": "at which the board shuts its valves [V]",
}
SURE = 3.0  # sigmas of a prediction
SHORTEST_BLIND, LONGEST_BLIND = 0.5, 3.0  # no model is trusted longer [s] [assumption]
DOUBLINGS, SETTLED = 50, 1e-13  # most iterations; relative change in the last
SILENT_S, SILENT_TICKS = 1.2, 12  # before the host calls a vehicle silent, at least
RARE = 1e-8  # per message: once in 460 hours with three vehicles at 10 Hz
USUAL_UNDERVOLTAGE = 8.0 / 12.0  # of the battery's voltage, where the file has none

OPERATORS = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip
FUNCTIONS = {"min": min, "max": max}


def words_of(
    vehicles: Sequence[Vehicle], table: Table, flight: FlightParams, guidance: GuidanceParams
) -> dict[str, float]:
    """The value of each word; of several vehicles, the one that gives more time or room."""
    mocap = table.mocap
    weakest = max(1e-6, min(weakest_force(one) / one.mass for one in vehicles))
    volts = [
        one.gauges.undervoltage_v or USUAL_UNDERVOLTAGE * one.gauges.battery_v for one in vehicles
    ]
    speed = flight.barrier.max_speed
    return {
        "frame": mocap.frame_s,
        "latency": mocap.latency_s,
        "jitter": mocap.jitter_s,
        "noise": mocap.noise,
        "period": flight.jet_period_s,
        "push": max(0.5 * sum(jet.thrust for jet in one.jets) / one.mass for one in vehicles),
        "top_speed": speed,
        "stop_s": speed / (SPARE_FORCE * weakest),
        "blind_s": blind_s(table, flight, len(vehicles)),
        "planned_s": guidance.preview_s + guidance.setpoint_life_s,
        "silence_s": silence_s(table.link, flight.jet_period_s),
        "gas_use": max(map(_gas_use, vehicles)),
        "undervoltage": max(volts),
    }


def _gas_use(vehicle: Vehicle) -> float:
    air, half = vehicle.air, 0.5 * sum(jet.thrust for jet in vehicle.jets)
    return (half / air.exhaust_speed + air.bearing_flow) / air.gas


def blind_s(table: Table, flight: FlightParams, vehicles: int) -> float:
    """Time without poses until SURE sigmas of the predicted position exceed the room [s].

    The room is what the safety filter keeps: to the fence, and half of that to another vehicle.
    """
    margins = flight.barrier
    room = min(margins.edge_margin, 0.5 * margins.vehicle_margin if vehicles > 1 else math.inf)
    mocap = table.mocap
    looks = np.arange(SHORTEST_BLIND, LONGEST_BLIND, 0.05)
    wide = prediction(flight.estimator, mocap.noise, mocap.frame_s, tuple(looks.tolist()))
    within = looks[SURE * np.array(wide) <= room]
    if len(within) == len(looks):
        return LONGEST_BLIND
    return float(within[-1]) if len(within) else SHORTEST_BLIND


@lru_cache(maxsize=64)
def prediction(
    params: EstimatorParams, noise: float, frame: float, looks: tuple[float, ...]
) -> list[float]:
    """Standard deviation of the predicted position, so long after the newest pose [m]."""
    noise = max(noise, 1e-5)
    before = steady(*_motion(frame, params), noise)
    if before is None:  # parameters beyond all reason
        return [math.inf] * len(looks)
    gain = before[:, :1] / (before[0, 0] + noise**2)
    after = before - gain @ before[:1]
    found = []
    for look in looks:
        step, own = _motion(look, params)
        variance = float((step @ after @ step.T + own)[0, 0])
        found.append(math.sqrt(variance) if variance >= 0.0 else math.inf)
    return found


def steady(step: NDArray[Any], own: NDArray[Any], noise: float) -> NDArray[Any] | None:
    """Covariance before a pose, once it no longer changes; None: it grows without limit.

    Doubling: iteration k covers 2^k frames. E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang,
    "Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations",
    International Journal of Control 77(8), 2004.

    Args:
        step: transition over a frame, shape (3, 3).
        own: process noise over a frame, shape (3, 3).
        noise: of a measured position [m].
    """
    a, g, h = step.T, np.zeros((3, 3)), own
    g[0, 0] = 1.0 / noise**2
    with np.errstate(all="ignore"):  # of numbers that grow without limit
        for _ in range(DOUBLINGS):
            spread = np.linalg.inv(np.eye(3) + g @ h)
            more = a.T @ h @ spread @ a
            a, g, h = a @ spread @ a, g + a @ spread @ g @ a.T, h + more
            if not np.isfinite(h).all():
                return None
            if (np.abs(more) <= SETTLED * np.abs(h)).all():
                return h
    return None


def _motion(h: float, params: EstimatorParams) -> tuple[NDArray[Any], NDArray[Any]]:
    """Transition and process noise of (position, velocity, bias) over `h`; see the estimator."""
    white, walk = params.force_noise**2, params.bias_walk**2
    step = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    own = white * np.array([[h**3 / 3, h**2 / 2, 0.0], [h**2 / 2, h, 0.0], [0.0, 0.0, 0.0]])
    own += walk * np.array([
        [h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h],
    ])  # fmt: skip
    return step, own


def silence_s(link: Link, period: float) -> float:
    """Longest silence of a healthy link with one message a period; longer ones are RARE [s]."""
    stay, leave = 1.0 - link.burst_enter, link.burst_leave
    turn = np.array([[stay, link.burst_enter], [leave, 1.0 - leave]])
    lost = np.array([link.loss, link.burst_loss])
    total = link.burst_enter + leave
    share = np.array([leave, link.burst_enter]) / total if total else np.array([1.0, 0.0])
    chance, count = share * lost, 1
    while chance.sum() > RARE and count < 100:  # a link that loses everything has no bound
        chance, count = (chance @ turn) * lost, count + 1
    # one more until the next arrives, and that one's delay
    return (count + 1) * period + link.delay_s + 5.0 * link.jitter_s


def vehicle_silent_s(table: Table, flight: FlightParams) -> float:
    """How long the host hears nothing from a vehicle until it stops all [s]."""
    period = flight.jet_period_s
    return max(SILENT_S, SILENT_TICKS * period, silence_s(table.link, period))


Texts = dict[tuple[str, str], str]  # arithmetic by row and bound


def take_texts(faults: Any) -> Texts:
    """Take the arithmetic out of a fault table's tree; numbers take its place."""
    texts: Texts = {}
    for name, row in faults.items() if isinstance(faults, dict) else ():
        for bound in ("above", "below") if isinstance(row, dict) else ():
            if isinstance(row.get(bound), str):
                texts[name, bound] = row[bound]
                row[bound] = 0.0
    return texts


def violations_in(texts: Texts, words: Mapping[str, float]) -> Iterator[Violation]:
    """Arithmetic that cannot be worked out."""
    for (name, bound), text in texts.items():
        try:
            value_of(text, words)
        except ValueError as error:
            yield Violation(("faults", name, bound), str(error), show(text))


def resolved(faults: FaultTable, texts: Texts, words: Mapping[str, float]) -> FaultTable:
    """The table with the value of each arithmetic."""
    rows = dict(faults)
    for (name, bound), text in texts.items():
        rows[name] = replace(rows[name], **{bound: value_of(text, words)})
    return rows


def value_of(text: str, words: Mapping[str, float]) -> float:
    """The value of arithmetic.

    Raises:
        ValueError: it is no arithmetic of these words.
    """
    if len(text) > 200:
        raise ValueError("at most 200 characters")
    try:
        value = float(_value(ast.parse(text.strip(), mode="eval").body, words))
    except (ZeroDivisionError, OverflowError):
        value = math.nan
    except (SyntaxError, RecursionError, MemoryError, TypeError):
        raise ValueError("arithmetic with + - * / ( ), min and max") from None
    if not math.isfinite(value):
        raise ValueError("arithmetic with a finite value")
    return round(min(max(value, -LARGEST), LARGEST), 9)  # 12 * 0.1 is 1.2


def _value(node: ast.expr, words: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return number
        case ast.Name(id=name) if name in words:
            return words[name]
        case ast.Name():
            raise ValueError(f"a number, or arithmetic of: {', '.join(words)}")
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_value(inner, words)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            return float(OPERATORS[type(op)](_value(left, words), _value(right, words)))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS and args:
            values = [_value(one, words) for one in args]
            return FUNCTIONS[name](values)
    raise ValueError("arithmetic with + - * / ( ), min and max")


def words_in(text: str) -> list[str]:
    """The words of arithmetic, in the order of WORDS."""
    names = {n.id for n in ast.walk(ast.parse(text.strip())) if isinstance(n, ast.Name)}
    return [name for name in WORDS if name in names]


def worked_out(text: str, words: Mapping[str, float]) -> str:
    """The arithmetic with the values of its words: "2 * frame, with frame 0.01"."""
    known = ", ".join(f"{name} {words[name]:.3g}" for name in words_in(text))
    return f"{text}, with {known}" if known else text
