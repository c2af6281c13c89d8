"""The board's limits, from the vehicle file and what protects the vehicle besides."""

import zlib

from msgspec import Struct

from firmware_interface.messages import VALVES, BearingPolicy, Config
from testbed.core.error import TestbedError
from testbed.core.jets import opposing_pairs
from testbed.core.vehicle import Positive, Valve, Vehicle


class Protection(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits that do not follow from the vehicle. Defaults are assumptions unless they say more.

    Bearing air stays on when the board trips: the jets are off then, but a vehicle that still
    moves and loses its film of air grinds to a halt on the granite, which harms both.
    """

    watchdog_s: Positive = 0.15  # seven frames of a sender that repeats at 50 Hz
    max_ttl_s: Positive = 1.0
    max_on_s: Positive = 5.0
    duty_window_s: Positive = 16.0
    duty_budget_s: Positive = 12.0  # of each valve in any window
    undervoltage_s: Positive = 0.002  # coils that pull in make the supply dip
    status_period_s: Positive = 0.05
    drop_bearing_on_trip: bool = False


class LimitsError(TestbedError, ValueError):
    """This vehicle does not fit the board."""


def micro(value: float) -> int:
    """Seconds to us, volts to uV: the nearest whole millionth."""
    return round(value * 1e6)


def dead_time_s(valve: Valve) -> float:
    """From closing a jet to opening its opposite, so that their flows never overlap [s]."""
    return max(0.0, valve.close_delay_s + valve.close_ramp_s - valve.open_delay_s)


def limits_of(vehicle: Vehicle, protection: Protection | None = None) -> Config:
    """What the firmware of this vehicle's board is built with.

    Raises:
        LimitsError: more jets than the board has outputs.
    """
    guard = protection or Protection()
    if not 1 <= len(vehicle.jets) <= VALVES:
        raise LimitsError(
            f"the vehicle has {len(vehicle.jets)} jets, the board drives 1 to {VALVES}"
        )
    opposing = [0] * VALVES
    for i, j in opposing_pairs(vehicle.jets):
        opposing[i] |= 1 << j
        opposing[j] |= 1 << i
    policy = BearingPolicy.DROP if guard.drop_bearing_on_trip else BearingPolicy.KEEP
    config = Config(
        valve_count=len(vehicle.jets),
        opposing=tuple(opposing),
        bearing_after_trip=policy,
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
    """Refuse limits that the firmware would refuse; it would stay in BOOT.

    Raises:
        LimitsError: which one, what was found and what was expected.
    """
    for name, (least, most) in Config.LIMITS.items():
        value = getattr(config, name)
        if not least <= value <= most:
            raise LimitsError(f"{name} is {value}, the board takes {least} to {most}")
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
    """What HELLO_ACK must carry."""
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
