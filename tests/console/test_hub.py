"""Readers of the hub: a quick one, a slow one, and one that comes late."""

import msgspec

from testbed.console.hub import KEPT, Hub
from testbed.console.valve_pulses import Pulse


def put(hub, k):
    hub.put({"t": 0.1 * k}, ([Pulse(0, 0, 0.1 * k, 0.1 * k + 0.05)], [[0, k, k]], [[k, "sat1"]]))


def get(hub, after):
    return msgspec.json.decode(hub.newest(after, 0.0))


def test_a_reader_gets_what_is_new_since_its_last_picture():
    hub = Hub()
    put(hub, 1)
    first = get(hub, -1)
    assert first["anew"]
    put(hub, 2)
    put(hub, 3)
    slow = get(hub, first["v"])
    assert not slow["anew"]
    assert slow["now"]["t"] == 0.1 * 3
    assert [point[1] for point in slow["trail"]] == [2, 3]
    assert [event[0] for event in slow["events"]] == [2, 3]
    again = get(hub, slow["v"])
    assert (again["trail"], again["pulses"], again["events"]) == ([], [], [])


def test_a_reader_that_missed_too_much_starts_anew():
    hub = Hub()
    for k in range(1, KEPT + 20):
        put(hub, k)
    late = get(hub, 1)
    assert late["anew"]
    assert len(late["trail"]) == KEPT + 19
    assert min(pulse[3] for pulse in late["pulses"]) >= 0.1 * (KEPT + 19) - 10.0
    assert get(hub, KEPT + 10_000)["anew"]  # of another server


def test_the_age_is_of_the_newest_message_not_of_the_status(monkeypatch):
    now = [10.0]
    monkeypatch.setattr("testbed.console.hub.monotonic", lambda: now[0])
    hub = Hub()
    assert get(hub, -1)["age"] is None
    put(hub, 1)
    now[0] += 55.0
    hub.set_status(stop={"words": "", "ready": True})
    answer = get(hub, 1)
    assert answer["age"] == 55.0
    assert answer["stop"]["ready"]
