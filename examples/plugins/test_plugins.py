"""The tests of a plug-in's author: one class for each, and what stands in for the hardware."""

import json
import socket
from collections.abc import Sequence

from gpio_board import GpioBoard
from springs import Springs
from testbed.conformance import (
    CamerasBench,
    LawConformance,
    PoseSourceConformance,
    ThrusterBench,
    ThrustersConformance,
)
from testbed.core.lab import MocapWire
from testbed.core.ports import Timer
from testbed.core.vehicle import Vehicle
from testbed.mocap.exposure import Sighting
from udp_json_cameras import UdpJsonCameras


class TestSprings(LawConformance):
    """The law, on the table and in orbit."""

    make = Springs
    dimensions = (2, 3)


def with_cameras() -> CamerasBench:
    """The plug-in at a port of loopback, and a sender."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    source = UdpJsonCameras(MocapWire(system="udp_json"), port)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def rubbish(data: bytes) -> None:
        sender.sendto(data, ("127.0.0.1", port))

    def send(number: int, bodies: dict[str, Sighting]) -> None:
        seen = {n: [*b.position, *b.rotation] if b.tracked else None for n, b in bodies.items()}
        rubbish(json.dumps({"frame": number, "age": 0.0, "bodies": seen}).encode())

    return CamerasBench(source, send, rubbish, sender.close)


class TestUdpJsonCameras(PoseSourceConformance):
    """The cameras, over loopback."""

    make = with_cameras


class MockChip:
    """Pins without a machine."""

    def __init__(self, pins: Sequence[int]) -> None:
        self.levels = dict.fromkeys(pins, False)

    def write(self, pin: int, level: bool) -> None:
        """See `Chip`."""
        self.levels[pin] = level

    def close(self) -> None:
        """See `Chip`."""


def on_a_mock(vehicle: Vehicle, clock: Timer) -> ThrusterBench:
    """The board on pins 0 to 7, the bearings on pin 26."""
    pins = list(range(len(vehicle.jets)))
    chip = MockChip([*pins, 26])
    board = GpioBoard(vehicle, clock, pins, 26, chip)
    return ThrusterBench(board, lambda: [chip.levels[i] for i in pins], lambda: chip.levels[26])


class TestGpioBoard(ThrustersConformance):
    """The board."""

    make = on_a_mock
