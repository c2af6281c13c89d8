"""The loop: who is called when, and how a flight ends."""

import pytest
from msgspec.structs import replace

from testbed.core.codes import FaultId, FaultReport, InhibitReason, Refusal, Response
from testbed.core.types import (
    Demand,
    Health,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    LawMessage,
    Outputs,
    PoseSample,
    Tick,
    ValveCommand,
    Vitals,
    Wrench,
)
from testbed.flight.loop import (
    LONGEST_STOP,
    LONGEST_WORDS,
    Ending,
    HostNode,
    VehicleNode,
    come_to_rest,
    fly,
)

PERIOD = 0.1  # [s]
STILL = Wrench(0.0, 0.0, 0.0)
BROKE, OVER = FaultReport("broke", "broke"), Refusal(InhibitReason.FLIGHT_OVER)
SAMPLE = PoseSample(0.08, 1.0, 2.0, 3.0)


class Clock:
    def __init__(self, diary):
        self.diary = diary

    def wait_until(self, t):
        self.diary.append(("wait", t))


class Node:
    """A vehicle or a host that writes its calls down and fails at tick number `fails_at`.

    It shuts its valves `slow` ticks after it was told of a fault elsewhere.
    """

    def __init__(self, diary, name, fails_at=None, slow=0):
        self.diary, self.name, self.fails_at, self.ticks = diary, name, fails_at, 0
        self.slow, self.told = slow, 0

    def tick(self, t, *armed):
        self.diary.append((self.name, t, *armed))
        fault = BROKE if self.fails_at is not None and self.ticks >= self.fails_at else None
        self.ticks += 1
        self.told += armed[-1] not in (True, False, None)
        shut = OVER if fault or self.told > self.slow else None
        health = Health(t, 0.0, 0.0)
        command = ValveCommand(self.ticks, t, t, (), ())
        return Tick(
            Inputs(t, bool(armed), (), None, {}, health),
            Outputs(t, None, None, STILL, STILL, command, shut, fault),
        )


class Host(Node):
    def tick(self, t, *armed):
        self.diary.append((self.name, t, *armed))
        return HostTick(HostInputs(t, None, {}), HostOutputs(t, None))


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


def broke(name):
    return replace(BROKE, vehicle=name)


def flown(diary, vehicles, hosts=(), ticks=3, **options):
    return fly(Clock(diary), vehicles, hosts, PERIOD, ticks, Observer(diary), **options)


def test_vehicles_first_then_hosts_then_all_wait(diary):
    nodes = [Node(diary, "a"), Node(diary, "b")]
    hosts = [Host(diary, "host a")]
    ending = flown(diary, nodes, hosts, ticks=1)
    assert diary == [
        ("wait", 0.0),
        ("a", 0.0, True, None), ("saw", "a"),
        ("b", 0.0, True, None), ("saw", "b"),
        ("host a", 0.0, True), ("saw", "host a"),
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


def test_a_fault_is_told_to_all_and_followed_by_one_disarmed_tick(diary):
    nodes = [Node(diary, "a"), Node(diary, "b", fails_at=1), Node(diary, "c", slow=2)]
    ending = flown(diary, nodes, ticks=9)
    assert ending == Ending(5 * PERIOD, broke("b"), found_t=PERIOD)
    told = [(entry[0], *entry[2:]) for entry in diary if entry[0] in "abc"]
    # in the tick of the fault the others had their turn already, or have it without knowing
    assert told[:6] == [(name, True, None) for name in "abcabc"]
    # then they come to rest, and the flight waits for the slowest of them
    assert told[6:-3] == [(name, True, broke("b")) for name in "abcabcabc"]
    assert told[-3:] == [(name, False, broke("b")) for name in "abc"]


def test_who_does_not_come_to_rest_is_not_waited_for_for_ever(diary):
    nodes = [Node(diary, "a", fails_at=0), Node(diary, "b", slow=1000)]
    ending = flown(diary, nodes, ticks=500)
    assert ending.t == pytest.approx(LONGEST_STOP + PERIOD)


def test_a_law_that_dies_on_the_host_is_a_fault_of_all(diary, make_state):
    class Dying:
        message = None

        def step(self, *_):
            raise ZeroDivisionError("of zero")

    ports = Ports({}, own=make_state())
    host = HostNode("a", Dying(), ports, PERIOD, lead=0.0)
    ending = flown(diary, [Node(diary, "a")], [host], ticks=9)
    fault = FaultReport(FaultId.HOST_LAW_RAISED, "law on the host: ZeroDivisionError: of zero", "a")
    assert ending == Ending(2 * PERIOD, fault, found_t=0.0)
    assert fault.words == "a: law on the host: ZeroDivisionError: of zero"
    assert ports.published == []


def test_long_last_words_of_a_law_are_cut(make_state):
    class Wordy:
        message = None

        def step(self, *_):
            raise ValueError("o" * 10_000)

    host = HostNode("a", Wordy(), Ports({}, own=make_state()), PERIOD, lead=0.0)
    text = host.tick(0.0).outputs.fault.text
    assert text.startswith("law on the host: ValueError: ooo")
    assert len(text) == len("law on the host: ") + LONGEST_WORDS


@pytest.mark.parametrize("longest", [1.2, 3.0])
def test_a_vehicle_is_silent_after_the_time_that_the_host_waits(longest, diary, make_state):
    class Deaf(Host):
        def tick(self, t, *armed):
            return HostTick(HostInputs(t, make_state(t=0.0), {}), HostOutputs(t, None))

    hosts = [Deaf(diary, "a")]
    node, seen = Node(diary, "a"), Observer(diary)
    ending = fly(Clock(diary), [node], hosts, PERIOD, 99, seen, silent_s=longest)
    assert ending.fault.id == FaultId.VEHICLE_SILENT
    assert longest < ending.found_t <= longest + 1.01 * PERIOD


def test_the_first_fault_is_the_reason(diary):
    ending = flown(diary, [Node(diary, "a", fails_at=2), Node(diary, "b", fails_at=2)], ticks=9)
    assert ending.fault == broke("a")


def test_a_fault_in_the_last_tick_is_told(diary):
    assert flown(diary, [Node(diary, "a", fails_at=2)], ticks=3).fault == broke("a")


def test_a_stop_between_two_ticks_ends_the_flight_before_the_second(diary):
    asked = []

    class Pressed(Clock):
        def wait_until(self, t):
            super().wait_until(t)
            if t == 2 * PERIOD:
                asked.append(t)

    nodes = [Node(diary, "a")]
    ending = fly(Pressed(diary), nodes, (), PERIOD, 9, Observer(diary), stopped=lambda: len(asked))
    assert ending == Ending(2 * PERIOD, None)
    assert [entry[1] for entry in diary if entry[0] == "a"] == [0.0, PERIOD]


def test_a_stop_before_the_flight_ends_it_after_one_tick(diary):
    ending = flown(diary, [Node(diary, "a")], ticks=9, stopped=lambda: 1)
    assert ending == Ending(PERIOD, None)


def test_a_stop_ends_the_flight_with_its_tick(diary):
    asked = iter([0, 0, 1])
    ending = flown(diary, [Node(diary, "a")], ticks=9, stopped=lambda: next(asked))
    assert ending == Ending(3 * PERIOD, None)
    assert [entry[2] for entry in diary if entry[0] == "a"] == [True, True, True]
    assert diary[-1] == ("wait", 3 * PERIOD)


@pytest.mark.parametrize(("times", "ticks"), [(1, 6), (2, 2)])
def test_the_second_stop_ends_also_the_stop_for_a_fault(diary, times, ticks):
    nodes = [Node(diary, "a", fails_at=0), Node(diary, "b", slow=3)]
    flown(diary, nodes, ticks=9, stopped=lambda: times)
    armed = [entry[2] for entry in diary if entry[0] == "b"]
    assert armed == [True] * (ticks - 1) + [False]


class Lander:
    """A vehicle that shuts its air off at its `at`-th tick, or when it may not brake."""

    def __init__(self, diary, name, at):
        self.diary, self.name, self.at, self.ticks = diary, name, at, 0

    def tick(self, t, armed, fleet=None, *, end=False):
        self.ticks += 1
        down = self.ticks >= self.at or not armed
        self.diary.append((self.name, t, armed, end, down))
        command = ValveCommand(self.ticks, t, t, (), ())
        outputs = Outputs(t, None, None, STILL, STILL, command, OVER, air_off=down)
        return Tick(Inputs(t, armed, (), None, {}, Health(t, 0.0, 0.0)), outputs)


def landed(diary, nodes, ticks=9, stopped=lambda: 0):
    come_to_rest(Clock(diary), nodes, PERIOD, 30, ticks, Observer(diary), stopped=stopped)
    return [entry for entry in diary if entry[0] in "ab"]


def test_after_the_flight_all_brake_until_the_last_one_has_landed(diary):
    ticks = landed(diary, [Lander(diary, "a", 1), Lander(diary, "b", 3)])
    assert ticks == [
        (name, k * PERIOD, True, True, name == "a" or k == 32)
        for k in (30, 31, 32) for name in "ab"
    ]  # fmt: skip
    assert ("wait", 30 * PERIOD) in diary  # the board hears of it within its watchdog's time


def test_who_does_not_come_to_rest_lands_as_it_is(diary):
    ticks = landed(diary, [Lander(diary, "a", 1000)], ticks=4)
    assert [armed for _, _, armed, _, _ in ticks] == [True] * 4 + [False]


def test_the_second_stop_lands_all_at_once(diary):
    asked = iter([1, 1, 2])
    ticks = landed(diary, [Lander(diary, "a", 1000)], stopped=lambda: next(asked))
    assert [armed for _, _, armed, _, _ in ticks] == [True, True, False]


# Nodes


class Agent:
    guidance = None

    def __init__(self, outputs):
        self.outputs, self.inputs = outputs, None

    def staying(self, t):
        return f"stay at {t}"

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

    def messages(self):
        return self.words

    def broadcast(self, message):
        self.said.append(message)

    def publish(self, message):
        self.published.append(message)

    def apply(self, command):
        self.applied.append(command)

    def health(self):
        return Health(1.0, 2.0, 3.0)


def setpoint_for(t):
    t = round(t, 3)
    return Demand(t, 0.1, 0.2, 0.0, 0.0, 0.0, t + 0.5)


class Guidance:
    def __init__(self, message=None):
        self.asked, self.message, self.filtered = [], message, None

    def step(self, t, own, neighbours, told):
        self.asked.append((t, own, neighbours, told))
        return setpoint_for(t)


COMMAND = ValveCommand(1, 0.0, 0.1, (0,) * 8, (0,) * 8)
OUTPUTS = Outputs(0.0, None, None, STILL, STILL, COMMAND, None, None)


def test_a_vehicle_listens_steps_acts_and_tells(make_state):
    neighbour, own = make_state((1.0, 0.0, 0.0)), make_state((2.0, 0.0, 0.0))
    ports, agent = Ports({"b": neighbour}, "newest"), Agent(replace(OUTPUTS, state=own))

    tick = VehicleNode("a", agent, ports, ports, ports).tick(0.3, True)

    expected = Inputs(0.3, True, (SAMPLE,), "newest", {"b": neighbour}, Health(1.0, 2.0, 3.0))
    assert agent.inputs == tick.inputs == expected
    assert tick.outputs is agent.outputs
    assert ports.applied == [COMMAND]
    assert ports.published == [own]


def test_a_law_on_board_obeys_no_setpoint_of_the_network():
    ports, agent = Ports({}, "of another sender"), Agent(OUTPUTS)
    agent.guidance = Guidance()
    node = VehicleNode("a", agent, ports, ports, ports)
    assert node.tick(0.3, True).inputs.setpoint is None
    assert node.tick(0.4, True, stay=True).inputs.setpoint == "stay at 0.4"


def test_a_vehicle_that_does_not_know_where_it_is_says_nothing():
    ports = Ports({})
    VehicleNode("a", Agent(OUTPUTS), ports, ports, ports).tick(0.3, False)
    assert ports.applied == [COMMAND]  # it does shut its valves
    assert ports.published == []


def test_a_host_answers_for_the_jet_period_after_the_coming_one(make_state):
    words, told = {"b": LawMessage(0.7, (1.0,))}, LawMessage(0.8, (2.0, 3.0))
    ports = Ports({"b": make_state()}, own=make_state((1.0, 0.0, 0.0)), told=words)
    guidance = Guidance(told)
    tick = HostNode("a", guidance, ports, PERIOD, lead=0.008).tick(0.5)
    assert guidance.asked == [(pytest.approx(0.608), ports.known, ports.heard, ports.words)]
    assert ports.published == [setpoint_for(0.608)]
    assert ports.said == [told]
    assert tick.outputs == HostOutputs(0.5, setpoint_for(0.608), told)
    assert tick.inputs.messages == words
    assert (tick.inputs.own, tick.inputs.neighbours) == (ports.known, ports.heard)


def test_a_law_starts_when_the_vehicle_is_armed_not_before(make_state):
    ports, guidance = Ports({}, own=make_state()), Guidance()
    host = HostNode("a", guidance, ports, PERIOD, lead=0.008)
    assert host.tick(0.5, False).outputs.setpoint is None
    assert guidance.asked == []
    assert host.tick(0.6, True).outputs.setpoint == setpoint_for(0.708)


@pytest.mark.parametrize("response", [Response.NONE, Response.BRAKE, Response.COAST, Response.LAND])
def test_landing_shuts_the_air_off(response):
    ports, landed = Ports({}), []
    ports.land = lambda: landed.append(True)
    agent = Agent(replace(OUTPUTS, response=response))
    VehicleNode("a", agent, ports, ports, ports).tick(0.3, True)
    assert landed == [True] * (response == Response.LAND)
    agent.outputs = replace(OUTPUTS, response=response, air_off=True)
    VehicleNode("a", agent, ports, ports, ports).tick(0.4, True)
    assert landed == [True] * (1 + (response == Response.LAND))


def test_a_vehicle_is_told_of_its_process_and_of_the_others():
    ports = Ports({})
    node = VehicleNode("a", Agent(OUTPUTS), ports, ports, ports, lambda: Vitals(late_s=0.2))
    assert node.tick(0.3, True).inputs.vitals == Vitals(late_s=0.2)
    told = node.tick(0.4, True, broke("b")).inputs.vitals
    assert told == Vitals(late_s=0.2, fleet=broke("b"))
    over = node.tick(0.5, True, end=True).inputs.vitals
    assert over == Vitals(late_s=0.2, end=True)


def test_a_host_waits_for_the_first_word_of_its_vehicle():
    ports, guidance = Ports({}), Guidance()
    tick = HostNode("a", guidance, ports, PERIOD, lead=0.008).tick(0.5)
    assert guidance.asked == []
    assert ports.published == []
    assert tick.outputs.setpoint is None
