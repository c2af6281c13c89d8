"""The board's unmodified image in virtual time, in lockstep with its host."""

from collections.abc import Sequence
from pathlib import Path

from firmware_interface.board import Edge
from firmware_interface.compiler import image
from firmware_interface.messages import Config, ResetCause
from firmware_interface.stm32 import Machine

# As in the board file, firmware/stm32f4/board.h.
VALVE_PINS, BEARING_PIN = 0x00FF, 0x0100
SUPPLY_FULL_MV, PRESSURE_FULL_PA, FULL = 33_000, 1_000_000, 4095


class UnicornBoard:
    """A `Board` in virtual time.

    Args:
        config: limits, see `limits.limits_of`.
        random: value of the chip's random generator, from which the boot nonce follows.
        clock_us: the board's own clock at power-on.
        supply_mv, supply_pa: initial readings of the sensors; the converter has steps of 8 mV.
        path: the image (.bin); built if not given.
    """

    virtual_time = True

    def __init__(
        self,
        config: Config,
        random: int = 1,
        clock_us: int = 0,
        supply_mv: int = 24_000,
        supply_pa: int = 500_000,
        path: Path | None = None,
    ) -> None:
        self._path = path or image(config).with_suffix(".bin")
        self._random, self._clock_us = random, clock_us
        self._sensed = (supply_mv, supply_pa)
        self._boot(ResetCause.POWER_ON)

    def _boot(self, cause: ResetCause) -> None:
        self._mask = 0
        self.machine = Machine(self._path, cause, self._random, self._clock_us, self._counts())

    def _counts(self) -> tuple[int, int]:
        """Converter counts of the sensors: the least counts that read as at least the values."""
        supply, pressure = self._sensed
        volts, pascals = -supply * FULL // SUPPLY_FULL_MV, -pressure * FULL // PRESSURE_FULL_PA
        return min(-volts, FULL), min(-pascals, FULL)

    @property
    def now_us(self) -> int:
        """The board's clock: time since power-on [us]."""
        return self.machine.now_us

    @property
    def bearing(self) -> bool:
        """Whether bearing air is on."""
        return bool(self.machine.pins & BEARING_PIN)

    def feed(self, data: bytes) -> None:
        """Send bytes to the board now."""
        self.machine.feed(data)

    def run_until(self, t_us: int) -> Sequence[Edge]:
        """Run up to and including `t_us`; returns edges since the last call, in order."""
        if t_us < self.now_us:
            raise ValueError(f"the board is already at {self.now_us} us, requested {t_us} us")
        self.machine.run_until(t_us)
        edges = []
        for at, pins in self.machine.outputs:
            if pins & VALVE_PINS != self._mask:
                self._mask = pins & VALVE_PINS
                edges.append(Edge(at, self._mask))
        self.machine.outputs.clear()
        return edges

    def read(self) -> bytes:
        """Bytes the board has sent since the last call."""
        data = bytes(self.machine.sent)
        self.machine.sent.clear()
        return data

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """Set the readings of the board's sensors, which are read at the next alarm."""
        self._sensed = (supply_mv, supply_pa)
        self.machine.adc = self._counts()

    def power_cycle(self, cause: ResetCause) -> None:
        """Reboot for this cause; time restarts at 0, sensor readings are kept."""
        self._random += 1
        self._boot(cause)

    def close(self) -> None:
        """Do nothing: the emulator frees its memory itself."""
