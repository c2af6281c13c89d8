"""A run fed in again gives the same outputs, bit for bit, also by way of rows of a log."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from testbed.config import find, load
from testbed.core.codes import FaultCause, FaultReport, InhibitReason, Refusal, Response
from testbed.core.rows import Rows
from testbed.core.types import (
    Accel,
    Demand,
    Health,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    Outputs,
    Pose,
    PoseSample,
    Reference,
    State,
    Tick,
    Trajectory,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.flight.agent import lead_time
from testbed.flight.flown_tick import FlownHostTick, FlownTick
from testbed.logs.block import Block
from testbed.logs.row_reader import RowReader
from testbed.logs.tick_row import RowWriter
from testbed.rig.chain import make_agent, make_guidance
from testbed.rig.twin import make_twin
from testbed.run.fly import names_of


class Keeper:
    """Observer that keeps every tick."""

    def __init__(self, names):
        self.vehicles = {name: [] for name in names}
        self.hosts = {name: [] for name in names}
        self.times = []

    def vehicle(self, name, tick):
        self.vehicles[name].append(tick)

    def host(self, name, tick):
        self.hosts[name].append(tick)

    def done(self, t):
        self.times.append(t)


def bits(message):
    """All of a message's content in order, floats to the last bit."""
    match message:
        case msgspec.Struct():
            return [type(message), *map(bits, msgspec.structs.astuple(message))]
        case dict():
            return [(name, bits(one)) for name, one in message.items()]
        case tuple() | list() | Rows():
            return [bits(one) for one in message]
        case float():
            return message.hex()
    return message


def through_rows(message, writer=None, reader=None):
    """A tick read from its row, with one memory of texts and names for a whole log."""
    reader = reader or RowReader()
    topic = "/sat1/host" if isinstance(message, HostTick) else "/sat1/tick"
    *known, row = (writer or RowWriter()).rows(topic, message.inputs.t, message)
    for one in known:
        reader.learn(one.topic, one.kind, one.data)
    make = reader.host if isinstance(message, HostTick) else reader.tick
    return make(topic, row.data)


def structs(tick):
    """The tick as structs."""
    return tick.tick if isinstance(tick, FlownTick | FlownHostTick) else tick


FLIGHTS = {
    "hold": ("hold", ["duration_s=10"]),
    "law on the vehicle": ("zhang2023_table_wrench", ["duration_s=4"]),
    "law on the host": ("zhang2023_table", ["duration_s=4"]),
    "forces of the host": ("zhang2023_table_wrench", ["duration_s=4", 'deploy.law="host"']),
    "beside an obstacle": ("zhang2023_table_pd", ["duration_s=9"]),
}


@pytest.fixture(scope="module", params=FLIGHTS)
def flight(request):
    """An experiment and what was kept of its flight."""
    name, overrides = FLIGHTS[request.param]
    experiment = load(find(name), overrides)
    keeper = Keeper(experiment.vehicles)
    ending = make_twin(experiment).fly(keeper)
    assert ending.fault is None
    return experiment, keeper


def test_replay_of_a_vehicle(flight):
    experiment, keeper = flight
    for name in experiment.vehicles:
        agent = make_agent(experiment, name)
        ticks = keeper.vehicles[name]
        assert len(ticks) == experiment.ticks
        assert any(any(tick.outputs.command.on_us) for tick in ticks)
        for tick in ticks:
            assert bits(agent.step(tick.inputs)) == bits(tick.outputs)


def test_replay_of_a_host(flight):
    experiment, keeper = flight
    for name, setup in experiment.vehicles.items():
        guidance = make_guidance(experiment, name)
        ahead = experiment.flight.jet_period_s + lead_time(setup.model)
        ticks = keeper.hosts[name]
        assert len(ticks) == (experiment.ticks if experiment.deploy.law == "host" else 0)
        for tick in ticks:
            t, own, heard = (
                tick.inputs.t,
                tick.inputs.own,
                (tick.inputs.neighbours, tick.inputs.messages),
            )
            again = None if own is None else guidance.step(t + ahead, own, *heard)
            assert bits(again) == bits(tick.outputs.setpoint)
            assert bits(guidance.message) == bits(tick.outputs.message)


def test_replay_through_the_log(flight):
    experiment, keeper = flight
    for name in experiment.vehicles:
        agent = make_agent(experiment, name)
        memory = RowWriter(), RowReader()
        for flown in keeper.vehicles[name]:
            tick = structs(flown)
            logged = through_rows(tick, *memory)
            assert bits(logged) == bits(tick)
            assert bits(agent.step(logged.inputs)) == bits(logged.outputs)
        for flown in keeper.hosts[name]:
            tick = structs(flown)
            assert bits(through_rows(tick, *memory)) == bits(tick)


def test_rows_of_a_block_are_those_of_the_structs(flight):
    """Made column by column, or tick by tick from structs: the same bytes in the same order."""
    experiment, keeper = flight
    together, alone = (RowWriter(names_of(experiment)) for _ in range(2))
    expected = []
    block, taken = Block(together), []
    for k, t in enumerate(keeper.times):
        for kind, ticks in (("tick", keeper.vehicles), ("host", keeper.hosts)):
            for name in experiment.vehicles:
                if k >= len(ticks[name]):
                    continue
                flown, topic = ticks[name][k], f"/{name}/{kind}"
                expected += [(t, one) for one in alone.rows(topic, t, structs(flown))]
                if isinstance(flown, FlownTick | FlownHostTick):
                    for one in together.before(topic, t, flown.fault):
                        block.add(t, one.topic, one)
                    block.add(t, topic, flown)
                else:
                    for one in together.rows(topic, t, flown):
                        block.add(t, one.topic, one)
        if k % 7 == 0:
            taken += block.take()
    assert taken + block.take() == expected


def test_replay_notices_another_gain(flight):
    experiment, keeper = flight
    tracker = replace(experiment.flight.tracker, heading_bandwidth=1.501)
    other = replace(experiment, flight=replace(experiment.flight, tracker=tracker))
    name = next(iter(experiment.vehicles))
    agent = make_agent(other, name)
    again = [agent.step(tick.inputs) for tick in keeper.vehicles[name]]
    assert again != [tick.outputs for tick in keeper.vehicles[name]]


def test_every_tick_is_seen(flight):
    experiment, keeper = flight
    period = experiment.flight.jet_period_s
    assert keeper.times == [k * period for k in range(experiment.ticks)]


# Any message


numbers = st.floats(allow_nan=False, allow_infinity=False)
whole = st.integers(0, 2**32 - 1)
poses, twists = st.builds(Pose, *[numbers] * 3), st.builds(Twist, *[numbers] * 3)
accels, wrenches = st.builds(Accel, *[numbers] * 3), st.builds(Wrench, *[numbers] * 3)
states = st.builds(State, numbers, poses, twists, accels, numbers, whole)
references = st.builds(Reference, numbers, poses, twists, accels)
demands = st.builds(Demand, *[numbers] * 7)
trajectories = st.builds(
    Trajectory, st.lists(references, min_size=1, max_size=3).map(tuple), numbers
)
setpoints = st.none() | trajectories | demands
words = st.text(max_size=20)
refusals = st.builds(
    Refusal, st.sampled_from(InhibitReason), st.lists(numbers, max_size=3).map(tuple)
)
faults = st.builds(
    FaultReport, words, words, words, words, st.none() | numbers,
    st.none() | st.builds(FaultCause, words, words, words), st.lists(words, max_size=2).map(tuple),
)  # fmt: skip
heard = st.dictionaries(st.text(max_size=8), states, max_size=2)
valves = st.lists(whole, min_size=8, max_size=8).map(tuple)
commands = st.builds(ValveCommand, whole, numbers, numbers, valves, valves)
ticks = st.builds(
    Tick,
    st.builds(
        Inputs, numbers, st.booleans(),
        st.lists(st.builds(PoseSample, *[numbers] * 4), max_size=3).map(tuple),
        setpoints, heard, st.builds(Health, *[numbers] * 3),
    ),
    st.builds(
        Outputs, numbers, st.none() | states, st.none() | references | demands,
        wrenches, wrenches, commands, st.none() | refusals, st.none() | faults,
        response=st.sampled_from(Response),
    ),
)  # fmt: skip
host_ticks = st.builds(
    HostTick,
    st.builds(HostInputs, numbers, st.none() | states, heard),
    st.builds(HostOutputs, numbers, setpoints),
)


@given(message=ticks | host_ticks)
def test_any_tick_survives_its_row(message):
    assert bits(through_rows(message)) == bits(message)


@given(messages=st.lists(ticks | host_ticks, max_size=4))
def test_ticks_survive_one_after_the_other(messages):
    memory = RowWriter(), RowReader()
    for message in messages:
        assert bits(through_rows(message, *memory)) == bits(message)


def a_tick(wrench, inputs=None):
    inputs = inputs or Inputs(0.0, True, (), None, {}, Health(0.0, 5e5, 2e7))
    return Tick(inputs, Outputs(0.0, None, None, wrench, wrench, ValveCommand(0, 0.0, 0.1, (), ())))


@pytest.mark.parametrize("number", [0.1, -0.0, 5e-324, 1.7976931348623157e308, 1e22, 2.0 / 3.0])
def test_a_float_keeps_its_bits(number):
    again = through_rows(a_tick(Wrench(number, 0.0, 0.0)))
    assert again.outputs.commanded_wrench.fx.hex() == number.hex()


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_none_survives(number):
    message = a_tick(Wrench(number, 0.0, 0.0))
    assert bits(through_rows(message)) == bits(message)


anything = st.floats(allow_subnormal=True).map(lambda x: math.nan if math.isnan(x) else x)


@given(
    samples=st.lists(st.builds(PoseSample, *[anything] * 4), max_size=3).map(tuple),
    demand=st.none() | st.builds(Demand, *[anything] * 7),
    health=st.builds(Health, *[anything] * 3),
)
def test_inputs_with_any_numbers_survive(samples, demand, health):
    message = a_tick(Wrench(0.0, 0.0, 0.0), Inputs(0.0, True, samples, demand, {}, health))
    assert bits(through_rows(message)) == bits(message)


@pytest.mark.parametrize("data", [b"", b"{}", bytes(500), b"\0\1\0\0" + bytes(2000)])
def test_what_is_no_row_is_an_error(data):
    for make in (RowReader().tick, RowReader().host):
        with pytest.raises(ValueError, match="expected"):
            make("/sat1/tick", data)
