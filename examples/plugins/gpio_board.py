"""Valves and bearing air on the pins of a Raspberry Pi.

    [lab.thrusters]
    system = "gpio"
    options = { valves = [4, 17, 27, 22, 5, 6, 13, 19], bearing = 26 }

Pin i of `valves` drives jet i of the vehicle's file; high is open. One thread opens and shuts, and
it is the watchdog, too: what no plan keeps open, it shuts. It dies with its process, and pins stay
in their last state: before air is on, put a monostable between each pin and its valve.
"""

import threading
from collections import deque
from typing import Annotated, Protocol

from msgspec import Meta

from testbed.core.ports import Timer
from testbed.core.types import Health, ValveCommand
from testbed.core.vehicle import Vehicle

LOOK_S = 1e-3  # between two looks for a new plan
ROUNDING_S = 1e-6  # plans are in whole microseconds
Pin = Annotated[int, Meta(ge=0, le=27)]


class Chip(Protocol):
    """The driver of the pins."""

    def write(self, pin: int, level: bool) -> None:
        """Make a pin high or low."""
        ...

    def close(self) -> None:
        """Give the pins back."""
        ...


class Lgpio:
    """The pins of this machine, by the package `lgpio`."""

    def __init__(self, pins: list[int]) -> None:
        import lgpio  # imported here, because experiments are also checked on machines without pins

        self._lgpio, self._handle = lgpio, lgpio.gpiochip_open(0)
        for pin in pins:
            lgpio.gpio_claim_output(self._handle, pin, 0)

    def write(self, pin: int, level: bool) -> None:
        """See `Chip`."""
        self._lgpio.gpio_write(self._handle, pin, int(level))

    def close(self) -> None:
        """See `Chip`."""
        self._lgpio.gpiochip_close(self._handle)


class GpioBoard:
    """A `ThrusterBoard`."""

    def __init__(
        self, vehicle: Vehicle, clock: Timer, valves: list[Pin], bearing: Pin, chip: Chip
    ) -> None:
        if len(valves) != len(vehicle.jets):
            raise ValueError(f"{len(valves)} pins in `valves`, {len(vehicle.jets)} jets")
        if len({*valves, bearing}) != len(valves) + 1:
            raise ValueError("a pin is named twice")
        self._pins, self._bearing, self._clock = valves, bearing, clock
        self._valve, self._air = vehicle.valve, vehicle.air
        self._lock = threading.Lock()
        self._plans: list[ValveCommand] = []  # the plan being played, and the next one
        self._mask = 0
        self._shut_at = [-1e9] * len(valves)  # when each was shut last [s]
        self._edges: deque[tuple[float, int]] = deque(maxlen=10_000)
        self._closed, self._failed = False, ""
        self._chip = chip
        self._thread = threading.Thread(target=self._keep, name="valves", daemon=True)
        self._thread.start()

    # The timer

    def _keep(self) -> None:
        try:
            while not self._closed:
                with self._lock:
                    now = self._clock.now
                    wake = min(self._play(now), now + LOOK_S)
                self._clock.wait_until(wake)
        except Exception as error:  # the vehicle asks for `health` ten times a second
            self._failed = f"{type(error).__name__}: {error}"

    def _play(self, now: float) -> float:
        """Open and shut what is due; when the next thing is [s]."""
        while len(self._plans) > 1 and self._plans[1].issued_at <= now:
            del self._plans[0]
        mask, due = 0, [p.issued_at for p in self._plans[1:]]
        for plan in self._plans[:1]:
            for i, (on, offset) in enumerate(zip(plan.on_us, plan.offset_us, strict=True)):
                begin = plan.issued_at + 1e-6 * offset
                end = min(begin + 1e-6 * on, plan.valid_until)
                if not self._mask >> i & 1:
                    begin = max(begin, self._shut_at[i] + self._valve.min_off_s)
                    if end - begin < self._valve.min_on_s - ROUNDING_S:
                        continue
                mask |= (begin <= now < end) << i
                due += [begin, end]
        self._set(mask, now)
        return min((t for t in due if t > now), default=now + LOOK_S)

    def _set(self, mask: int, now: float) -> None:
        changed = self._mask ^ mask
        for i, pin in enumerate(self._pins):
            if changed >> i & 1:
                self._chip.write(pin, bool(mask >> i & 1))
                if not mask >> i & 1:
                    self._shut_at[i] = now
        if changed:
            self._mask = mask
            self._edges.append((now, mask))

    # What the vehicle says

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        with self._lock:
            if not self._closed:
                self._plans = [*self._plans[:1], command]
                self._play(self._clock.now)

    def disarm(self) -> None:
        """See `ThrusterBoard`."""
        with self._lock:
            self._plans = []
            self._set(0, self._clock.now)

    def bearing(self, *, on: bool) -> None:
        """See `ThrusterBoard`."""
        with self._lock:
            if not self._closed:
                self._chip.write(self._bearing, on)

    def land(self) -> None:
        """See `Thrusters`."""
        try:
            self.disarm()
        finally:
            self.bearing(on=False)

    def health(self) -> Health:
        """See `Thrusters`. No gauge hangs on the pins: the regulator is believed."""
        if self._failed:
            raise OSError(self._failed)
        return Health(self._clock.now, self._air.set_pressure, 0.0)

    def edges(self) -> list[tuple[float, int]]:
        """See `ThrusterBoard`."""
        with self._lock:
            found = list(self._edges)
            self._edges.clear()
        return found

    def close(self) -> None:
        """See `ThrusterBoard`."""
        with self._lock:
            if self._closed:
                return
            self._closed, self._plans = True, []
        self._thread.join()
        try:
            self._set(0, self._clock.now)
        finally:
            self._chip.write(self._bearing, False)
            self._chip.close()


def on_this_machine(vehicle: Vehicle, clock: Timer, valves: list[Pin], bearing: Pin) -> GpioBoard:
    """The board on this machine's pins; the entry point names it."""
    return GpioBoard(vehicle, clock, valves, bearing, Lgpio([*valves, bearing]))
