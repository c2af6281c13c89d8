"""The loop: who is called when, and how a flight ends."""

import pytest
from msgspec.structs import replace

from testbed.core.types import (
    Health,
    HostOutputs,
    Inputs,
    Outputs,
    PoseSample,
    Tick,
    Told,
    ValveCommand,
    Wrench,
)
from testbed.flight.loop import Ending, HostNode, VehicleNode, fly

PERIOD = 0.1  # [s]
STILL = Wrench(0.0, 0.0, 0.0)
SAMPLE = PoseSample(0.08, 1.0, 2.0, 3.0)


class Clock:
    def __init__(self, diary):
        self.diary = diary

    def wait_until(self, t):
        self.diary.append(("wait", t))


class Node:
    """A vehicle or a host that writes its calls down and fails at tick number `fails_at`."""

    def __init__(self, diary, name, fails_at=None):
        self.diary, self.name, self.fails_at, self.ticks = diary, name, fails_at, 0

    def tick(self, t, *armed):
        self.diary.append((self.name, t, *armed))
        fault = "broke" if self.ticks == self.fails_at else None
        self.ticks += 1
        health = Health(t, 0.0, 0.0)
        command = ValveCommand(self.ticks, t, t, (), ())
        return Tick(
            Inputs(t, bool(armed), (), None, {}, health),
            Outputs(t, None, None, STILL, STILL, command, fault, fault),
        )


class Observer:
    def __init__(self, diary):
        self.diary = diary

    def vehicle(self, name, tick):
        self.diary.append(("saw", name))

    def host(self, name, tick):
        self.diary.append(("saw", name))

    def done(self, t):
        self.diary.append(("done", t))


@pytest.fixture
def diary():
    return []


def flown(diary, vehicles, hosts=(), ticks=3, **options):
    return fly(Clock(diary), vehicles, hosts, PERIOD, ticks, Observer(diary), **options)


def test_vehicles_first_then_hosts_then_everybody_waits(diary):
    nodes = [Node(diary, "a"), Node(diary, "b")]
    hosts = [Node(diary, "host a")]
    ending = flown(diary, nodes, hosts, ticks=1)
    assert diary == [
        ("wait", 0.0),
        ("a", 0.0, True), ("saw", "a"),
        ("b", 0.0, True), ("saw", "b"),
        ("host a", 0.0), ("saw", "host a"),
        ("done", 0.0),
        ("wait", PERIOD),
    ]  # fmt: skip
    assert ending == Ending(PERIOD, None)


def test_ticks_are_due_at_multiples_of_the_period(diary):
    # not at sums of it, which drift
    flown(diary, [Node(diary, "a")], ticks=1000)
    assert [entry[1] for entry in diary if entry[0] == "wait"] == [
        k * PERIOD for k in range(1001)
    ]  # fmt: skip


def test_a_fault_is_followed_by_one_disarmed_tick_of_all(diary):
    nodes = [Node(diary, "a"), Node(diary, "b", fails_at=1), Node(diary, "c")]
    ending = flown(diary, nodes, ticks=9)
    assert ending == Ending(2 * PERIOD, "b: broke")
    armed = [(entry[0], *entry[2:]) for entry in diary if entry[0] in "abc"]
    # the others had their tick already, or have it still
    assert armed == [(name, True) for name in "abcabc"] + [(name, False) for name in "abc"]


def test_the_first_fault_is_the_reason(diary):
    ending = flown(diary, [Node(diary, "a", fails_at=2), Node(diary, "b", fails_at=2)], ticks=9)
    assert ending.fault == "a: broke"


def test_a_fault_in_the_last_tick_is_told(diary):
    assert flown(diary, [Node(diary, "a", fails_at=2)], ticks=3).fault == "a: broke"


def test_it_ends_when_it_is_stopped(diary):
    asked = iter([False, False, True])
    ending = flown(diary, [Node(diary, "a")], ticks=9, stopped=lambda: next(asked))
    assert ending == Ending(2 * PERIOD, None)
    assert diary[-1] == ("done", 2 * PERIOD)


# Nodes


class Agent:
    def __init__(self, outputs, hears_neighbours):
        self.outputs, self.hears_neighbours, self.inputs = outputs, hears_neighbours, None

    def step(self, inputs):
        self.inputs = inputs
        return self.outputs


class Ports:
    """Poses, thrusters and link of one vehicle, and of its host, in one."""

    def __init__(self, neighbours, setpoint=None, own=None, told=None):
        self.heard, self.newest, self.known = neighbours, setpoint, own
        self.published, self.applied = [], []
        self.words, self.said = told or {}, []

    def samples(self):
        return [SAMPLE]

    def setpoint(self):
        return self.newest

    def own(self):
        return self.known

    def neighbours(self):
        return self.heard

    def told(self):
        return self.words

    def tell(self, told):
        self.said.append(told)

    def publish(self, message):
        self.published.append(message)

    def apply(self, command):
        self.applied.append(command)

    def health(self):
        return Health(1.0, 2.0, 3.0)


class Guidance:
    def __init__(self, told=None):
        self.asked, self.told = [], told

    def step(self, t, own, neighbours, told):
        self.asked.append((t, own, neighbours, told))
        return f"setpoint for {t:.3f}"


COMMAND = ValveCommand(1, 0.0, 0.1, (0,) * 8, (0,) * 8)
OUTPUTS = Outputs(0.0, None, None, STILL, STILL, COMMAND, None, None)


@pytest.mark.parametrize("hears", [True, False])
def test_a_vehicle_listens_steps_acts_and_tells(hears, make_state):
    neighbour, own = make_state((1.0, 0.0, 0.0)), make_state((2.0, 0.0, 0.0))
    ports, agent = Ports({"b": neighbour}, "newest"), Agent(replace(OUTPUTS, state=own), hears)

    tick = VehicleNode("a", agent, ports, ports, ports).tick(0.3, True)

    expected = Inputs(
        0.3, True, (SAMPLE,), "newest", {"b": neighbour} if hears else {}, Health(1.0, 2.0, 3.0)
    )
    assert agent.inputs == tick.inputs == expected
    assert tick.outputs is agent.outputs
    assert ports.applied == [COMMAND]
    assert ports.published == [own]


def test_a_vehicle_that_does_not_know_where_it_is_says_nothing():
    ports = Ports({})
    VehicleNode("a", Agent(OUTPUTS, True), ports, ports, ports).tick(0.3, False)
    assert ports.applied == [COMMAND]  # it does shut its valves
    assert ports.published == []


def test_a_host_answers_for_the_jet_period_after_the_coming_one(make_state):
    words, told = {"b": Told(0.7, (1.0,))}, Told(0.8, (2.0, 3.0))
    ports = Ports({"b": make_state()}, own=make_state((1.0, 0.0, 0.0)), told=words)
    guidance = Guidance(told)
    tick = HostNode("a", guidance, ports, PERIOD, lead=0.008).tick(0.5)
    assert guidance.asked == [(pytest.approx(0.608), ports.known, ports.heard, ports.words)]
    assert ports.published == ["setpoint for 0.608"]
    assert ports.said == [told]
    assert tick.outputs == HostOutputs(0.5, "setpoint for 0.608", told)
    assert tick.inputs.told == words
    assert (tick.inputs.own, tick.inputs.neighbours) == (ports.known, ports.heard)


def test_a_host_waits_for_the_first_word_of_its_vehicle():
    ports, guidance = Ports({}), Guidance()
    tick = HostNode("a", guidance, ports, PERIOD, lead=0.008).tick(0.5)
    assert guidance.asked == []
    assert ports.published == []
    assert tick.outputs.setpoint is None
