"""Schemas of the log that Foxglove reads, and messages that fit them."""

import json

import msgspec
import pytest

from foxglove_rules import misfits, refused
from testbed.core.types import (
    Demand,
    Health,
    HostTick,
    Inputs,
    Outputs,
    Pose,
    Reference,
    Tick,
    Trajectory,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.flight.supervisor import Event
from testbed.logs.feed import Loop
from testbed.logs.message import Decoder, from_json, to_json
from testbed.logs.plain_schema import plain_schema
from testbed.logs.recorder import Motion, Truth
from testbed.metrics.characterisation import Characterisation
from testbed.net.commands import Pace
from testbed.rig.boards import Valves

KINDS = [Tick, HostTick, Truth, Loop, Pace, Valves, Event, Characterisation]
ZERO = Wrench(0.0, 0.0, 0.0)
SHUT = ValveCommand(0, 0.0, 0.1, (0,) * 8, (0,) * 8)
EARLY = Tick(
    Inputs(0.0, True, (), None, {}, Health(0.0, 5e5, 2e7)),
    Outputs(0.0, None, None, ZERO, ZERO, SHUT),
)


@pytest.mark.parametrize("vehicles", [(), ("sat1", "sat2")])
@pytest.mark.parametrize("kind", KINDS)
def test_foxglove_reads_every_schema(kind, vehicles):
    schema = plain_schema(kind, vehicles)
    assert refused(schema) == []
    assert (schema["type"], schema["title"]) == ("object", kind.__name__)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.parametrize("kind", [Tick, HostTick, Truth])
def test_it_would_not_read_what_msgspec_says(kind):
    schema = msgspec.json.schema(kind)
    assert refused(schema["$defs"][kind.__name__])


@pytest.mark.parametrize(
    ("property_", "why"),
    [
        ({"$ref": "#/$defs/Pose"}, "a reference"),
        ({"anyOf": [{"type": "null"}, {"type": "number"}]}, "a choice"),
        ({"type": ["number", "null"]}, "type"),
        ({"type": "null"}, "type"),
        ({"enum": ["a"]}, "type None"),
        ({"type": "object", "additionalProperties": {"type": "number"}}, "without properties"),
        ({"type": "array", "items": {"type": "array", "items": {}}}, "type 'array'"),
        ({"type": "array", "prefixItems": [{"type": "number"}]}, "type 'array'"),
    ],
)  # fmt: skip
def test_the_checker_finds_what_the_app_refuses(property_, why):
    (found,) = refused({"type": "object", "properties": {"x": property_}})
    assert why in found


def test_all_fields_but_the_samples_are_named():
    properties = plain_schema(Tick, ["sat1", "sat2"])["properties"]
    inputs, outputs = properties["inputs"]["properties"], properties["outputs"]["properties"]
    assert set(Inputs.__struct_fields__) - set(inputs) == {"samples"}
    assert set(inputs["neighbours"]["properties"]) == {"sat1", "sat2"}
    assert set(outputs) == set(Outputs.__struct_fields__)
    assert outputs["command"]["properties"]["on_us"] == {
        "type": "array", "items": {"type": "integer"},
    }  # fmt: skip
    assert outputs["response"] == {"type": "integer"}
    assert outputs["fault"]["properties"]["id"] == {"type": "string"}
    assert not {"state", "active_setpoint", "fault"} & set(properties["outputs"]["required"])


def test_one_of_several_structs_has_the_fields_of_all():
    setpoint = plain_schema(Tick)["properties"]["inputs"]["properties"]["setpoint"]
    assert setpoint["properties"]["type"] == {"type": "string", "enum": ["Trajectory", "Demand"]}
    assert {"references", "fx_w", "theta"} <= set(setpoint["properties"])
    assert setpoint["required"] == ["type", "valid_until"]
    pose, still = Pose(1.0, 2.0, 3.0), Twist(0.0, 0.0, 0.0)
    accel = msgspec.convert(
        {"ax": 0.0, "ay": 0.0, "alpha": 0.0}, Reference.__annotations__["accel"]
    )
    path = Trajectory((Reference(0.0, pose, still, accel),), 1.0)
    for one in (path, Demand(0.0, 1.0, 2.0, 3.0, 0.0, 0.0, 1.0)):
        assert misfits(setpoint, json.loads(to_json(one))) == []


def test_the_checker_finds_what_does_not_fit():
    schema = plain_schema(Truth, ["sat1"])
    good = {"t": 0, "vehicles": {"sat1": dict.fromkeys(Motion.__struct_fields__, 1.5)}}
    assert misfits(schema, good) == []
    for wrong in (
        {"t": 0.0}, {**good, "t": None}, {**good, "t": "nan"}, {**good, "t": True},
        {**good, "vehicles": []}, {**good, "vehicles": {"sat2": good["vehicles"]["sat1"]}},
        {**good, "more": 1},
    ):  # fmt: skip
        assert misfits(schema, wrong)


def test_what_is_none_is_left_out_and_comes_back():
    data = to_json(EARLY)
    assert b"null" not in data
    assert "state" not in json.loads(data)["outputs"]
    assert misfits(plain_schema(Tick), {**json.loads(data)}) == [".inputs.samples: unnamed"]
    assert from_json(data, Tick) == EARLY


def test_a_log_of_an_older_version_spells_none_out():
    assert Decoder(Tick).decode(msgspec.json.encode(EARLY)) == EARLY


@pytest.mark.parametrize("data", [b"{}", b"[]", b'{"inputs": {}, "outputs": {}}', b"{", b"3"])
def test_what_is_no_message_is_an_error(data):
    with pytest.raises(msgspec.DecodeError):
        Decoder(Tick).decode(data)
