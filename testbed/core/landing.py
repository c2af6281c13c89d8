"""How far a vehicle goes without jets or with all of them, and when it has to land.

Without jets a vehicle drifts at v and gains a = `slope` per second. Without bearing air it slows
down with s = mu g - a. A drift of t seconds and the slide take

    v t + a t^2 / 2 + (v + a t)^2 / (2 s)  =  (w^2 - v^2) / (2 a) + w^2 / (2 s),   w = v + a t
"""

import math

from testbed.core.vehicle import Landing

GRAVITY = 9.81  # [m/s^2]
PADS = 0.5  # the pads' distance from the middle over the radius of the vehicle [assumed]
WATCHDOG_S = 0.15  # time without commands after which a board shuts its valves [s]


def landing_delay(landing: Landing, watchdog: float = WATCHDOG_S) -> float:
    """Longest delay from the watchdog to air off at which the vehicle stops within `room` [s].

    0: the room is used up already, so the air goes off at once. Infinite: it stays on.
    """
    if not landing.by_board:
        return math.inf
    v, a, room = landing.speed, landing.slope, landing.room
    s = landing.friction * GRAVITY - a
    if s <= 0.0:  # slides down the slope anyway
        return 0.0
    if a > 0.0:
        w = math.sqrt((2.0 * a * room + v**2) * s / (a + s))
        longest = (w - v) / a
    else:
        longest = (room - v**2 / (2.0 * s)) / v
    return max(0.0, longest - watchdog)


def brakes_shorter(landing: Landing, decel: float, wait: float) -> bool:
    """Whether the jets stop a vehicle in less distance than the table does without bearing air.

    Both go down the slope, at the fastest speed.

    Args:
        landing: figures of the vehicle.
        decel: of its jets in every direction [m/s^2].
        wait: until the jets push [s]; the air is off at once.
    """
    v, a = landing.speed, landing.slope
    brake, slide = decel - a, landing.friction * GRAVITY - a
    if brake <= 0.0:
        return False
    return slide <= 0.0 or v * wait + 0.5 * a * wait**2 + (v + a * wait) ** 2 / (
        2.0 * brake
    ) < v**2 / (2.0 * slide)
