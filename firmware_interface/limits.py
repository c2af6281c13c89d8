"""The board's limits, from the vehicle file and from additional protection parameters."""

import math
import struct
import zlib
from collections.abc import Sequence

from msgspec import Struct

from firmware_interface.messages import VALVES, BearingPolicy, Config
from testbed.core.error import TestbedError
from testbed.core.jets import opposing_pairs
from testbed.core.landing import WATCHDOG_S, landing_delay
from testbed.core.vehicle import Jet, Positive, Valve, Vehicle


class Protection(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits that do not follow from the vehicle. Defaults without a comment are assumptions."""

    watchdog_s: Positive = WATCHDOG_S  # seven frames of a sender that repeats at 50 Hz
    max_ttl_s: Positive = 1.0
    max_on_s: Positive = 5.0
    duty_window_s: Positive = 16.0
    duty_budget_s: Positive = 12.0  # of each valve in any window
    undervoltage_s: Positive = 0.002  # the supply dips when valves switch on
    status_period_s: Positive = 0.05


class LimitsError(TestbedError, ValueError):
    """The board cannot drive this vehicle."""


def micro(value: float) -> int:
    """Convert seconds to us or volts to uV, rounded to the nearest integer."""
    return round(value * 1e6)


def dead_time_s(valve: Valve) -> float:
    """Time from closing a jet to opening its opposite without overlapping flows [s]."""
    return max(0.0, valve.close_delay_s + valve.close_ramp_s - valve.open_delay_s)


def layout(jets: Sequence[Jet]) -> int:
    """CRC-32 of the jets' places and directions, in their order, to 1 mm and 0.01.

    Not of their thrust: a calibrated vehicle keeps its firmware.
    """
    rows = (
        struct.pack(
            "<4h",
            *(round(1e3 * value) for value in jet.position),
            *(round(1e2 * value) for value in jet.push),
        )
        for jet in jets
    )
    return zlib.crc32(b"".join(rows))


def limits_of(vehicle: Vehicle, protection: Protection | None = None) -> Config:
    """The limits that the firmware of this vehicle's board is built with.

    Raises:
        LimitsError: more jets than the board has outputs.
    """
    guard = protection or Protection()
    if not 1 <= len(vehicle.jets) <= VALVES:
        found = f"the vehicle has {len(vehicle.jets)} jets, the board drives 1 to {VALVES}"
        raise LimitsError(
            where="the jets of a vehicle", expected=f"1 to {VALVES} jets", found=found,
            hint="only the twin flies it, with `testbed run`; boards, bench and commissioning"
            " need a vehicle file with fewer jets",
        )  # fmt: skip
    opposing = [0] * VALVES
    for i, j in opposing_pairs(vehicle.jets):
        opposing[i] |= 1 << j
        opposing[j] |= 1 << i
    delay = landing_delay(vehicle.landing, guard.watchdog_s)
    longest = 1e-6 * Config.LIMITS["land_after_us"][1]
    config = Config(
        valve_count=len(vehicle.jets),
        opposing=tuple(opposing),
        jets=layout(vehicle.jets),
        bearing_after_trip=BearingPolicy.DROP if math.isfinite(delay) else BearingPolicy.KEEP,
        land_after_us=micro(min(delay, longest)) if math.isfinite(delay) else 0,
        min_on_us=micro(vehicle.valve.min_on_s),
        min_off_us=micro(vehicle.valve.min_off_s),
        dead_us=micro(dead_time_s(vehicle.valve)),
        max_on_us=micro(guard.max_on_s),
        duty_window_us=micro(guard.duty_window_s),
        duty_budget_us=micro(guard.duty_budget_s),
        max_ttl_us=micro(guard.max_ttl_s),
        watchdog_us=micro(guard.watchdog_s),
        undervoltage_mv=round(1e3 * vehicle.gauges.undervoltage_v),
        undervoltage_us=micro(guard.undervoltage_s),
        status_period_us=micro(guard.status_period_s),
    )
    check(config)
    return config


def check(config: Config) -> None:
    """Reject limits with which the firmware would stay in BOOT.

    Raises:
        LimitsError: names the limit, the value found and the expected values.
    """
    for name, (least, most) in Config.LIMITS.items():
        value = getattr(config, name)
        if not least <= value <= most:
            raise LimitsError(f"{name} is {value}, the board accepts {least} to {most}")
    if not config.min_on_us <= config.max_on_us:
        raise LimitsError(f"min_on_us {config.min_on_us} is above max_on_us {config.max_on_us}")
    if not config.min_on_us <= config.duty_budget_us <= config.duty_window_us:
        raise LimitsError(
            f"duty_budget_us is {config.duty_budget_us}, expected min_on_us ({config.min_on_us})"
            f" to duty_window_us ({config.duty_window_us})"
        )
    if config.duty_window_us % 16:
        raise LimitsError(f"duty_window_us is {config.duty_window_us}, not a multiple of 16")
    for i, against in enumerate(config.opposing):
        for j in range(VALVES):
            if against >> j & 1 and (
                j == i or j >= config.valve_count or not config.opposing[j] >> i & 1
            ):
                raise LimitsError(
                    f"opposing[{i}] names valve {j}: expected another valve that names {i}"
                )


def config_hash(config: Config) -> int:
    """CRC-32 of the limits, which HELLO_ACK must contain."""
    return zlib.crc32(config.pack())


def board_header(config: Config) -> str:
    """C source of a board's limits: `static const abt_config BOARD_CONFIG`."""
    lines = []
    for name in Config.__struct_fields__:
        value = getattr(config, name)
        text = "{" + ", ".join(f"{v}u" for v in value) + "}" if isinstance(value, tuple) else value
        lines.append(f"    .{name} = {text if isinstance(text, str) else f'{int(text)}u'},")
    return "\n".join(
        [
            f"/* Limits of one vehicle, hash {config_hash(config):08x}; generated. */",
            "#ifndef ABT_BOARD_CONFIG_H",
            "#define ABT_BOARD_CONFIG_H",
            "",
            '#include "abt_messages.h"',
            "",
            "static const abt_config BOARD_CONFIG = {",
            *lines,
            "};",
            "",
            "#endif",
            "",
        ]
    )
