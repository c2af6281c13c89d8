"""The host's clock is watched, and a slow network never looks like a clock that was set."""

from types import SimpleNamespace

import pytest

from testbed.net.clock import HostClock, Reader
from testbed.net.keys import Keys
from testbed.realtime.clock_sync import ClockOffset


class Network:
    """Answers in hand: the host's clock is `ahead` [s], the way takes `there` and `back` [s]."""

    def __init__(self):
        self.t, self.ahead, self.there, self.back = 1.0, 0.0, 0.0, 0.0
        self.asked = []
        self.says: bytes | None = None  # instead of its clock

    @property
    def now(self):
        return self.t

    def get(self, key, answers, timeout):
        self.asked.append(key)
        self.t += self.there
        stamp = self.says or round(1e9 * (self.t + self.ahead)).to_bytes(8, "little")
        self.t += self.back
        answers.callback(SimpleNamespace(ok=SimpleNamespace(payload=Payload(stamp))))


class Payload:
    def __init__(self, data):
        self._data = data

    def to_bytes(self):
        return self._data


@pytest.fixture
def watched(monkeypatch):
    network = Network()
    clock = HostClock(network, Keys("lab"), network, 0)
    ticks = iter(range(0, 10**12, 10**9))  # each look is late enough to ask again
    monkeypatch.setattr("testbed.net.clock.monotonic_ns", lambda: next(ticks) + 10**9)
    monkeypatch.setattr(
        "testbed.net.clock.zenoh.handlers.Callback",
        lambda call, indirect: SimpleNamespace(callback=call),
    )
    return network, clock


def test_clocks_that_agree(watched):
    network, clock = watched
    network.there = network.back = 0.001
    assert clock.off() == 0.0
    assert clock.trip == pytest.approx(0.002)
    assert network.asked == ["lab/host/clock"]


@pytest.mark.parametrize("ahead", [0.05, -0.05])
def test_a_clock_that_was_set_is_seen(watched, ahead):
    network, clock = watched
    network.there = network.back = 0.001
    network.ahead = ahead
    assert clock.off() == pytest.approx(ahead, abs=0.0011)


@pytest.mark.parametrize(("there", "back"), [(0.3, 0.0), (0.0, 0.3), (0.15, 0.15)])
def test_a_slow_network_is_no_clock_that_was_set(watched, there, back):
    network, clock = watched
    network.there, network.back = there, back
    assert clock.off() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("said", [bytes(7), bytes(9), b"\xff" * 200_000])
def test_an_answer_that_is_no_time_is_not_taken(watched, said):
    network, clock = watched
    network.ahead = 5.0
    network.says = said
    clock.off()
    assert clock.off() == 0.0
    assert clock.trip is None


def test_a_vehicle_that_waits_goes_on_reading_and_knows_how_well(watched):
    network, _ = watched
    offset, network.says = ClockOffset(), (10**15).to_bytes(8, "little")
    reader = Reader(network, Keys("lab"), offset)
    assert reader.unsure() > 100.0
    reader.look()
    assert 0.0 <= reader.unsure() == pytest.approx(0.5e-9 * offset.best.delay_ns)
