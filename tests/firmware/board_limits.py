"""Limits of the board that the firmware's tests configure."""

from firmware_interface.messages import BearingPolicy, Config

# Small odd numbers, so that no two limits can be mistaken for each other.
LIMITS = Config(
    valve_count=8,
    opposing=(1 << 5, 1 << 4, 1 << 7, 1 << 6, 1 << 1, 1 << 0, 1 << 3, 1 << 2),
    jets=0x5EA15EA1,
    bearing_after_trip=BearingPolicy.KEEP,
    land_after_us=0,
    min_on_us=10_007,
    min_off_us=9_001,
    dead_us=2_003,
    max_on_us=400_009,
    duty_window_us=3_200_000,
    duty_budget_us=1_500_011,
    max_ttl_us=900_001,
    watchdog_us=150_001,
    undervoltage_mv=18_000,
    undervoltage_us=1_999,
    status_period_us=50_000,
)
