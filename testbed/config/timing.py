"""Validates times and rates."""

from collections.abc import Iterator

from testbed.config.error import Violation
from testbed.config.experiment import Experiment
from testbed.core.vehicle import Vehicle

SHORTEST_PERIOD = 0.001  # [s] boards count microseconds; hosts wake up with an error below this
MOST_TICKS = 10**6  # per vehicle; they stay in memory until the run is judged
MOST_FRAMES = 10**7  # of motion capture; they stay in memory, too
FASTEST_CAMERA = 10_000.0  # [Hz]
MOST_STEPS = 10_000  # steps of a law per jet period
MOST_REFERENCES = 100  # per message
MOST_DELAY = 2.0  # largest valve delay in jet periods
LONGEST_AFTER = 3.0  # jet periods that a pulse may flow after its plan's; four are remembered
MOST_LATE = 3.0  # of [spread] delay_s [sigmas]
HAIR = 1e-9  # [s] tolerance for rounding errors


def bad_timing(experiment: Experiment) -> Iterator[Violation]:
    """Errors in times and rates."""
    yield from _run(experiment)
    yield from _camera(experiment)
    yield from _guidance(experiment)
    for name, setup in experiment.vehicles.items():
        key = ("vehicles", name, "model")
        late = MOST_LATE * experiment.table.spread.delay_s
        for violation in _valves(setup.model, experiment.flight.jet_period_s, late):
            yield violation._replace(key=(*key, *violation.key))
        air = setup.model.air
        if air.bearing_flow * experiment.duration_s > air.gas:
            lasts = air.gas / air.bearing_flow
            expected = f"at most {lasts:g} s: then the bearings of {name} have used all its gas"
            yield Violation(("duration_s",), expected, f"{experiment.duration_s:g} s")


def _run(experiment: Experiment) -> Iterator[Violation]:
    duration, period = experiment.duration_s, experiment.flight.jet_period_s
    if period < SHORTEST_PERIOD:
        expected = f"at least {SHORTEST_PERIOD:g} s"
        yield Violation(("flight", "jet_period_s"), expected, f"{period:g} s")
    if duration < period:
        yield Violation(
            ("duration_s",), f"at least flight.jet_period_s, {period:g} s", f"{duration:g} s"
        )
    if duration > MOST_TICKS * period:
        expected = f"at most {MOST_TICKS} jet periods, {MOST_TICKS * period:g} s"
        yield Violation(("duration_s",), expected, f"{duration:g} s")


def _camera(experiment: Experiment) -> Iterator[Violation]:
    mocap, key = experiment.table.mocap, ("table", "mocap", "rate_hz")
    if mocap.rate_hz > FASTEST_CAMERA:
        yield Violation(key, f"at most {FASTEST_CAMERA:g} Hz", f"{mocap.rate_hz:g} Hz")
    if mocap.rate_hz * experiment.duration_s > MOST_FRAMES:
        expected = f"at most {MOST_FRAMES:.0e} frames in {experiment.duration_s:g} s"
        yield Violation(key, expected, f"{mocap.rate_hz * experiment.duration_s:.1e}")
    timeout = experiment.flight.gate.pose_timeout_s
    if mocap.latency_s >= timeout:
        expected = f"less than flight.gate.pose_timeout_s, {timeout:g} s"
        yield Violation(("table", "mocap", "latency_s"), expected, f"{mocap.latency_s:g} s")
    elif mocap.frame_s + mocap.latency_s >= timeout:
        slowest = 1.0 / (timeout - mocap.latency_s)
        expected = f"more than {slowest:.3g} Hz: the gate waits {timeout:g} s for a pose"
        yield Violation(key, expected, f"{mocap.rate_hz:g} Hz")


def _guidance(experiment: Experiment) -> Iterator[Violation]:
    guidance, period = experiment.guidance, experiment.flight.jet_period_s
    if period > MOST_STEPS * guidance.step_s:
        expected = f"at least {period / MOST_STEPS:g} s, {MOST_STEPS} steps in a jet period"
        yield Violation(("guidance", "step_s"), expected, f"{guidance.step_s:g} s")
    if guidance.preview_s > MOST_REFERENCES * period:
        expected = f"at most {MOST_REFERENCES} jet periods, {MOST_REFERENCES * period:g} s"
        yield Violation(("guidance", "preview_s"), expected, f"{guidance.preview_s:g} s")


def _valves(vehicle: Vehicle, period: float, late: float) -> Iterator[Violation]:
    """A plan must start, flow and end before it is forgotten; valves may be `late` [s]."""
    valve = vehicle.valve
    expected = f"at most flight.jet_period_s, {period:g} s"
    for key, time in (
        (("command_delay_s",), vehicle.command_delay_s),
        (("valve", "min_on_s"), valve.min_on_s),
        (("valve", "min_off_s"), valve.min_off_s),
        (("valve", "open_ramp_s"), valve.open_ramp_s),
        (("valve", "close_ramp_s"), valve.close_ramp_s),
    ):
        if time > period + HAIR:
            yield Violation(key, expected, f"{time:g} s")
    for name in ("open_delay_s", "close_delay_s"):
        if (delay := getattr(valve, name)) > MOST_DELAY * period + HAIR:
            longest = f"at most {MOST_DELAY:g} times flight.jet_period_s, {MOST_DELAY * period:g} s"
            yield Violation(("valve", name), longest, f"{delay:g} s")
    before = vehicle.command_delay_s + valve.close_ramp_s + late
    if before + valve.close_delay_s > LONGEST_AFTER * period + HAIR:
        longest = f"at most {max(0.0, LONGEST_AFTER * period - before):g} s: with {before:g} s of"
        longest += " delay and ramp a pulse would flow for more than three jet periods too long"
        yield Violation(("valve", "close_delay_s"), longest, f"{valve.close_delay_s:g} s")
    if valve.open_delay_s - valve.close_delay_s > period + HAIR:
        nothing = f"less than {valve.close_delay_s + period:g} s, or nothing flows in a jet period"
        yield Violation(("valve", "open_delay_s"), nothing, f"{valve.open_delay_s:g} s")
    shortest = valve.close_delay_s + valve.close_ramp_s - valve.open_delay_s
    if valve.min_off_s < shortest - HAIR:
        expected = f"at least {shortest:g} s: before, the valve is still closing"
        yield Violation(("valve", "min_off_s"), expected, f"{valve.min_off_s:g} s")
