"""The table: granite, obstacles, motion capture and wireless link."""

import math
from typing import Annotated

from msgspec import Meta, Struct, field

from testbed.core.lab import Lab
from testbed.core.vehicle import NonNegative, Point, Positive

Probability = Annotated[float, Meta(ge=0.0, le=1.0)]


class Tilt(Struct, frozen=True, forbid_unknown_fields=True):
    """Acceleration along the surface because it is not level: uniform plus a map.

    `map` holds rows from the table's lower edge to the upper one, each with [ax, ay] from left to
    right, on an even grid that spans the table; values between nodes are bilinear.
    """

    uniform: Point  # [m/s^2]
    map: list[list[Point]] = []  # [m/s^2]

    @property
    def steepest(self) -> float:
        """Largest acceleration at any node [m/s^2]."""
        x, y = self.uniform
        nodes = [node for row in self.map for node in row] or [(0.0, 0.0)]
        return max(math.hypot(x + ax, y + ay) for ax, ay in nodes)


class Patch(Struct, frozen=True, forbid_unknown_fields=True):
    """A disc of the table where the bearings' gap closes and dry friction slows a vehicle."""

    position: Point  # its centre [m]
    radius: Positive  # [m]
    slows: Positive  # while the vehicle's middle is inside [m/s^2]


class Spread(Struct, frozen=True, forbid_unknown_fields=True):
    """Standard deviations of what the vehicle files do not know about this lab."""

    thrust: NonNegative = 0.0  # of all jets of a vehicle together, relative
    delay_s: NonNegative = 0.0  # of each valve
    hose: NonNegative = 0.0  # force of a hose or cable, each axis in W [N]
    hose_torque: NonNegative = 0.0  # [N m]
    body: NonNegative = 0.0  # the cameras' body from the vehicle's middle, each axis [m]
    body_deg: NonNegative = 0.0  # and its heading
    clock_s: NonNegative = 0.0  # the cameras' clock from the vehicles'


class Mocap(Struct, frozen=True, forbid_unknown_fields=True):
    """Rate, latency, noise and drop-outs of the cameras."""

    rate_hz: Positive
    latency_s: NonNegative  # exposure to arrival
    jitter_s: NonNegative  # one standard deviation of the latency, never earlier than half of it
    noise: NonNegative  # position, one standard deviation [m]
    noise_deg: NonNegative  # heading, one standard deviation
    dropout_rate: NonNegative  # rate at which a body is lost [1/s]
    dropout_s: NonNegative  # mean length of a loss

    @property
    def frame_s(self) -> float:
        """Time between two frames [s]."""
        return 1.0 / self.rate_hz

    @property
    def oldest_s(self) -> float:
        """Largest age of a pose while one frame is late or lost, as in the row `pose_stale` [s]."""
        return self.latency_s + 2.0 * self.frame_s + 8.0 * self.jitter_s


class Link(Struct, frozen=True, forbid_unknown_fields=True):
    """Wireless link with burst loss (Gilbert-Elliott)."""

    delay_s: NonNegative
    jitter_s: NonNegative  # exponential tail, mean
    loss: Probability  # of a message in the good state
    burst_loss: Probability  # of a message in the bad state
    burst_enter: Probability  # good -> bad, per message
    burst_leave: Probability  # bad -> good, per message
    range_m: Positive | None = None  # radio range between vehicles; without: unlimited


class Obstacle(Struct, frozen=True, forbid_unknown_fields=True):
    """A disc to keep away from; `solid` is the body that a vehicle would hit."""

    position: tuple[float, float]  # [m]
    radius: Positive  # danger radius: centre to centre [m]
    solid: NonNegative = 0.0  # radius of the body in its middle; 0: no body [m]
    velocity: tuple[float, float] = (0.0, 0.0)  # [m/s]


class Table(Struct, frozen=True, forbid_unknown_fields=True):
    """A rectangular table; its frame W has the origin in the middle."""

    size: tuple[Positive, Positive]  # along x and y [m]
    restitution: Annotated[float, Meta(ge=0.0, le=1.0)]  # of any contact
    tilt: Tilt
    mocap: Mocap
    link: Link
    friction: list[Patch] = []
    spread: Spread = Spread()
    lab: Lab = field(default_factory=Lab)
