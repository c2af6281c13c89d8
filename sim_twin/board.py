"""A modelled driver board: plans in, opening and closing commands to the solenoids out.

`FirmwareBoard` replaces it by real firmware, whose output edges are the commands.

Command times are integer nanoseconds, so the behaviour is exact. Rules, the same as the firmware's:

* a plan starts `command_delay_s` after it was issued, replaces the previous one at once, and is
  played once: no valve stays open after its pulses or its time to live, whichever ends first;
* a pulse shorter than the minimum on-time is not played;
* a valve that has just closed opens again only after the minimum off-time; the rest of the pulse
  is then played if it is still long enough. A pulse that continues one of the previous plan
  without a gap is the same opening.

Plans are in whole microseconds, and a jet period may be no whole number of them. A pulse that ends
less than ROUNDED before its plan lasts to the plan's end, because the sender extends it, as
`firmware_interface.session.carried` does on wires.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sim_twin.randomness import Words, normal, words
from testbed.core.compiled import compiled, with_fixed_types
from testbed.core.landing import WATCHDOG_S, landing_delay
from testbed.core.types import ValveCommand
from testbed.core.vehicle import Vehicle

SLOTS = 4  # pulses stored per jet: the one that closes, the one that flows, and spares
LONG_AGO = -(10**15)  # time of unused slots [ns]
ROUNDED = 1500  # of on-time, offset and period, each to half a microsecond [ns]
LONG_AFTER = 10**15  # closing time of a valve not yet closed [ns]


class Pulses(NamedTuple):
    """Opening and closing commands of one vehicle, oldest first; unused slots are `LONG_AGO`."""

    up: NDArray[np.int64]  # (jets, SLOTS) [ns]
    down: NDArray[np.int64]  # (jets, SLOTS) [ns]
    strength: NDArray[np.float64]  # (jets, SLOTS) relative thrust of this pulse


def no_pulses(*shape: int) -> Pulses:
    """Empty pulse tables; `shape` is (jets,), or (vehicles, jets) for a fleet."""
    never = np.full((*shape, SLOTS), LONG_AGO, dtype=np.int64)
    return Pulses(never, never.copy(), np.ones((*shape, SLOTS)))


@compiled
def play(wires, issued, valid_until, times_us):
    """Add a plan to the board's pulses, in place.

    Args:
        wires: of the board.
        issued: time at which the plan was made [s].
        valid_until: time at which it expires [s].
        times_us: on-times, then offsets, shape (2 jets,) [us].

    Returns:
        number of openings added.
    """
    pulses, spread, noise = wires.pulses, wires.spread, wires.noise
    delay, min_on, min_off = wires.times[0], wires.times[1], wires.times[2]
    openings, jets = 0, times_us.shape[0] // 2
    start, end = delay + round(issued * 1e9), delay + round(valid_until * 1e9)
    for j in range(jets):
        strength = 1.0 + spread * normal(noise)
        up, down, on = pulses.up[j], pulses.down[j], 1000 * times_us[j]
        up_at = start + 1000 * times_us[jets + j]
        down_at = min(up_at + on, end)
        if on > 0 and down_at > end - ROUNDED:
            down_at = end
        if up[-1] >= start:  # of the old plan and not begun: cancelled
            up[1:], down[1:] = up[:-1].copy(), down[:-1].copy()
            pulses.strength[j, 1:] = pulses.strength[j, :-1].copy()
            up[0] = down[0] = LONG_AGO
            openings -= 1
        if down[-1] >= start - 1:  # still open, or closing at this instant, to a nanosecond
            if on > 0 and up_at <= start:
                down[-1] = max(down_at, start)
                continue
            down[-1] = min(down[-1], start)
        up_at = max(up_at, down[-1] + min_off)
        if on == 0 or on < min_on or down_at - up_at < min_on or down_at <= up_at:
            continue
        up[:-1], down[:-1] = up[1:].copy(), down[1:].copy()
        pulses.strength[j, :-1] = pulses.strength[j, 1:].copy()
        up[-1], down[-1] = up_at, down_at
        pulses.strength[j, -1] = strength
        openings += 1
    return openings


def last_closing(pulses: Pulses) -> float:
    """End of the last commanded pulse, in the past or future [s]."""
    return 1e-9 * float(pulses.down.max())


def nanoseconds(seconds: float) -> int:
    """The nearest whole nanosecond."""
    return round(seconds * 1e9)


class Wires(NamedTuple):
    """What `play` needs of a board that does not change."""

    pulses: Pulses
    times: NDArray[np.int64]  # (3,) command delay, shortest pulse, shortest gap [ns]
    spread: float  # standard deviation of the relative thrust of a pulse
    noise: Words  # stream of the pulses' thrust


class Board:
    """One vehicle's modelled board; records its pulses and counts openings."""

    def __init__(self, vehicle: Vehicle, pulses: Pulses, rng: np.random.Generator) -> None:
        valve = vehicle.valve
        # as the firmware is told them: a shortest pulse in whole microseconds is played
        limits = (1000 * round(1e6 * one) for one in (valve.min_on_s, valve.min_off_s))
        whole = np.array([nanoseconds(vehicle.command_delay_s), *limits])
        self.wires = Wires(pulses, whole, vehicle.tolerance.pulse, words(rng))
        self.pulses = pulses
        self.openings = 0
        self._play = with_fixed_types(play)
        self._down = (math.inf, math.inf)  # interval without power [s]
        self._silent = (math.inf, math.inf)  # interval without commands [s]
        self._patience = WATCHDOG_S + landing_delay(vehicle.landing)
        self.floats = True

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw the pulses' thrust from another generator from now on."""
        self.wires.noise[:] = words(rng)

    def lose_power(self, since: float, until: float) -> None:
        """Cut the power from `since` to `until` [s]: all valves close, plans are ignored."""
        if self._down == (since, until):
            return
        self._down, at = (since, until), nanoseconds(since)
        never = self.pulses.up >= at
        self.pulses.up[never] = self.pulses.down[never] = LONG_AGO
        np.minimum(self.pulses.down, at, out=self.pulses.down)

    def apply(self, command: ValveCommand) -> None:
        """Play a plan."""
        if self._down[0] <= command.issued_at < self._down[1]:
            return
        times = np.array(command.on_us + command.offset_us)
        self.openings += self._play(self.wires, command.issued_at, command.valid_until, times)

    def land(self) -> None:
        """Nothing to do: the plant shuts the air off."""

    def fall_silent(self, since: float, until: float) -> None:
        """No commands come from `since` to `until` [s]."""
        self._silent = since, until

    def run_until(self, t: float) -> None:
        """Land if commands stopped long ago; plans are played ahead."""
        if self._silent[0] + self._patience <= min(t, self._silent[1]):
            self.floats = False


class Driver(Protocol):
    """Firmware that drives the solenoids in place of the modelled board."""

    def apply(self, command: ValveCommand) -> None:
        """Take a plan."""
        ...

    def land(self) -> None:
        """Shut valves and bearing air permanently."""
        ...

    @property
    def floats(self) -> bool:
        """Whether bearing air is on."""
        ...

    def run_until(self, t_us: int) -> Sequence[tuple[int, int]]:
        """Run until `t_us` and return edges of the outputs (time [us], mask); jet 0 is bit 0."""
        ...


class FirmwareBoard:
    """One vehicle's solenoids, driven by a `Driver`."""

    def __init__(
        self, vehicle: Vehicle, pulses: Pulses, rng: np.random.Generator, driver: Driver
    ) -> None:
        self._spread = vehicle.tolerance.pulse
        self._rng, self._driver = rng, driver
        self._mask = 0
        self.edges: list[tuple[int, int]] = []  # all so far, as the driver gave them
        self.pulses = pulses
        self.openings = 0

    def reseed(self, rng: np.random.Generator) -> None:
        """See `Board`."""
        self._rng = rng

    def apply(self, command: ValveCommand) -> None:
        """Pass a plan on."""
        self._driver.apply(command)

    def land(self) -> None:
        """Pass the landing on."""
        self._driver.land()

    @property
    def floats(self) -> bool:
        """Whether bearing air is on."""
        return self._driver.floats

    def run_until(self, t: float) -> None:
        """Fetch the valve edges up to time `t` [s]."""
        for at_us, mask in self._driver.run_until(round(t * 1e6)):
            for jet in range(len(self.pulses.up)):
                if (mask ^ self._mask) >> jet & 1:
                    self._switch(jet, at_us * 1000, opens=bool(mask >> jet & 1))
            self._mask = mask
            self.edges.append((at_us, mask))

    def _switch(self, jet: int, at: int, *, opens: bool) -> None:
        up, down, strength = (array[jet] for array in self.pulses)
        if not opens:
            down[-1] = at
            return
        for array in (up, down, strength):
            array[:-1] = array[1:].copy()
        up[-1], down[-1] = at, LONG_AFTER
        strength[-1] = 1.0 + self._spread * self._rng.standard_normal()
        self.openings += 1
