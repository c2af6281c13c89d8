"""The firmware in this process, in virtual time: the same C core that the board's chip runs."""

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from firmware_interface.board import Edge
from firmware_interface.compiler import firmware_id, shared_library
from firmware_interface.messages import Config, ResetCause

ROOM = 65536  # capacity for bytes and edges per call


class _Edge(ctypes.Structure):
    _fields_ = (("t_us", ctypes.c_uint64), ("mask", ctypes.c_uint32))


@cache
def library(path: Path) -> ctypes.CDLL:
    """Load the shared library and declare the argument types of its functions."""
    lib = ctypes.CDLL(str(path))
    board, u32, u64 = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint64
    for name, result, *arguments in (
        ("board_new", board, ctypes.c_char_p, u32, u32, u32, u32, u32, u32),
        ("board_free", None, board),
        ("board_sense", None, board, u32, u32),
        ("board_feed", None, board, ctypes.c_char_p, u32),
        ("board_run_until", None, board, u64),
        ("board_take_edges", u32, board, ctypes.POINTER(_Edge), u32),
        ("board_take_bytes", u32, board, ctypes.c_char_p, u32),
        ("board_bearing", u32, board),
        ("board_entered", u32, board),
        ("board_hold", None, board, u32),
        ("board_oversleep", None, board, u32),
        ("board_skip", None, board, u32),
        ("board_flip_open", None, board, u32),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


class InprocBoard:
    """A `Board` in virtual time.

    Args:
        config: limits, see `limits.limits_of`.
        boot_nonce: of the first boot; every power cycle adds one.
        clock_us: the board's own clock at power-on.
        supply_mv, supply_pa: initial readings of the sensors.
        path: the shared library; built if not given.
    """

    virtual_time = True

    def __init__(
        self,
        config: Config,
        boot_nonce: int = 1,
        clock_us: int = 0,
        supply_mv: int = 24_000,
        supply_pa: int = 500_000,
        path: Path | None = None,
    ) -> None:
        self.lib = library(path or shared_library())
        self._config = config.pack()
        self._nonce = boot_nonce
        self._clock_us = clock_us
        self._sensed = (supply_mv, supply_pa)
        self._edges = (_Edge * 4096)()
        self._bytes = ctypes.create_string_buffer(ROOM)
        self.handle: int | None = None
        self._boot(ResetCause.POWER_ON)

    def _boot(self, cause: ResetCause) -> None:
        self._now_us = 0
        self.handle = self.lib.board_new(
            self._config, firmware_id(), self._nonce, cause, self._clock_us, *self._sensed
        )
        if self.handle is None:
            raise MemoryError

    @property
    def now_us(self) -> int:
        """The board's clock: time since power-on [us]."""
        return self._now_us

    @property
    def bearing(self) -> bool:
        """Whether bearing air is on."""
        return bool(self.lib.board_bearing(self.handle))

    @property
    def entered(self) -> int:
        """Nesting depth of critical sections; must be 0 between calls."""
        return int(self.lib.board_entered(self.handle))

    def feed(self, data: bytes) -> None:
        """Send bytes to the board now."""
        self.lib.board_feed(self.handle, data, len(data))

    def run_until(self, t_us: int) -> Sequence[Edge]:
        """Run up to and including `t_us`; returns edges since the last call, in order."""
        if t_us < self._now_us:
            raise ValueError(f"the board is already at {self._now_us} us, requested {t_us} us")
        self._now_us = t_us
        self.lib.board_run_until(self.handle, t_us)
        count = self.lib.board_take_edges(self.handle, self._edges, len(self._edges))
        return [Edge(e.t_us, e.mask) for e in self._edges[:count]]

    def read(self) -> bytes:
        """Bytes the board has sent since the last call."""
        count = self.lib.board_take_bytes(self.handle, self._bytes, ROOM)
        return self._bytes.raw[:count]

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """Set the readings of the board's sensors from now on."""
        self._sensed = (supply_mv, supply_pa)
        self.lib.board_sense(self.handle, supply_mv, supply_pa)

    def skip(self, us: int) -> None:
        """Fault injection: advance time without alarms; only received bytes run the firmware."""
        self._now_us += us
        self.lib.board_skip(self.handle, us)

    def power_cycle(self, cause: ResetCause) -> None:
        """Reboot for this cause; time restarts at 0, sensor readings are kept."""
        self.close()
        self._nonce += 1
        self._boot(cause)

    def close(self) -> None:
        """Free the firmware's memory."""
        self.lib.board_free(self.handle)
        self.handle = None
