"""Messages for ROS 2: the shipped package, the page of reference, and other people's readers."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testbed.core.codes import FaultReport
from testbed.core.records import cdr, ros, standard
from testbed.core.records import messages as _messages  # noqa: F401
from testbed.core.records.definition import DTYPES, MESSAGES, parse
from testbed.core.records.kinds import EventKind
from testbed.core.records.layout import Layout
from testbed.core.records.type_hash import type_hash
from testbed.logs.packing import form, leaves, only
from testbed.logs.row_reader import fault_of
from testbed.logs.tick_row import event_of

ROOT = Path(ros.__file__).parents[3]
SHIPPED = Path(ros.__file__).parent / "testbed_msgs"
AGAIN = "run `python -m testbed.core.records`"
EVENT = {"t": 1.5, "kind": 3, "id": "jet", "text": "jet 3 \u2192 shut", "parts": "{}"}


def test_the_ros_package_is_what_the_definitions_give() -> None:
    found = {
        str(path.relative_to(SHIPPED)): path.read_text(encoding="utf-8")
        for path in SHIPPED.rglob("*")
        if path.is_file()
    }
    assert found == ros.package(), AGAIN


def test_the_page_of_messages_is_what_the_definitions_give() -> None:
    assert (ROOT / "docs/messages.md").read_text(encoding="utf-8") == ros.page(), AGAIN


def test_every_field_has_a_meaning_or_a_message() -> None:
    said = {one.name for one in MESSAGES.values() if one.meaning}
    for name, one in MESSAGES.items():
        if "/" in name:
            continue
        assert name in said
        for k, field in enumerate(one.fields):
            counted = field.sequence and one.fields[k - 1].meaning
            plain = (
                counted
                or field.name == "reserved"
                or field.kind in MESSAGES
                or field.kind == "string"
            )
            coded = field.name in one.codes
            assert plain or coded or field.meaning, (name, field.name)


@pytest.mark.parametrize("name", sorted(MESSAGES))
def test_a_definition_survives_its_own_text(name: str) -> None:
    again = parse(name, ros.msg_text(MESSAGES[name]))
    assert again.fields == MESSAGES[name].fields


def sample(name: str, noise: np.random.Generator, depth: int = 0) -> Any:
    """A message with a value in every field."""
    found = {}
    for one in MESSAGES[name].fields:
        number = 2 if one.sequence else one.length
        values = [_value(one.kind, noise) for _ in range(1 if number is None else number)]
        found[one.name] = values[0] if number is None else values
    return found


def _value(kind: str, noise: np.random.Generator) -> Any:
    match kind:
        case "string":
            return "".join(map(chr, noise.integers(97, 122, noise.integers(0, 9))))
        case "bool":
            return bool(noise.integers(2))
        case "float32":
            return float(np.float32(noise.normal()))
        case "float64":
            return float(noise.normal())
        case _ if kind in MESSAGES:
            return sample(kind, noise)
    return int(noise.integers(0, 100))


@pytest.mark.parametrize("name", sorted(MESSAGES))
def test_a_message_survives_cdr(name: str) -> None:
    message = sample(name, np.random.default_rng(1))
    assert cdr.decode(MESSAGES[name], cdr.encode(name, message)) == message


def test_half_a_character_is_spelled() -> None:
    found = cdr.decode(MESSAGES["Event"], cdr.encode("Event", EVENT | {"text": "a\udc80"}))
    assert found["text"] == r"a\udc80"
    report = FaultReport("law", "raised \udc80", "sat1")
    found = cdr.decode(MESSAGES["Event"], event_of(1.0, EventKind.FAULT, report))
    assert fault_of(found) == FaultReport("law", r"raised \udc80", "sat1")


def test_broken_bytes_are_refused() -> None:
    data = cdr.encode("Event", EVENT)
    for length in range(len(data) - 1):
        with pytest.raises(cdr.CdrError):
            cdr.decode(MESSAGES["Event"], data[:length])
    endless = cdr.encode("Names", {"vehicles": ["a"]})
    with pytest.raises(cdr.CdrError, match="elements"):
        cdr.decode(MESSAGES["Names"], endless[:12] + b"\xff\xff\xff\x7f" + endless[16:])


def rosbags_store():
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for one in MESSAGES.values():
        if "/" not in one.name:
            types.update(get_types_from_msg(ros.msg_text(one), ros.ros_name(one.name)))
    store.register(types)
    return store


def plain(value: Any) -> Any:
    """The same message as dicts and lists."""
    if hasattr(value, "__msgtype__"):
        names = value.__dataclass_fields__
        return {n: plain(getattr(value, n)) for n in names if n[0] != "_" and not n.isupper()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(one) for one in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", sorted(MESSAGES))
def test_rosbags_reads_every_message(name: str) -> None:
    store = rosbags_store()
    message = sample(name, np.random.default_rng(2))
    found = store.deserialize_cdr(cdr.encode(name, message), ros.ros_name(name))
    assert plain(found) == message


@pytest.mark.parametrize("name", sorted(MESSAGES))
def test_rosbags_computes_the_same_type_hash(name: str) -> None:
    assert type_hash(name) == rosbags_store().hash_rihs01(ros.ros_name(name))


def test_another_field_has_another_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    hash_now = type_hash.__wrapped__  # without the cache, which keeps what another test asked for
    twist, state = hash_now("Twist"), hash_now("State")
    changed = parse("Twist", "float64 vx\nfloat64 vy\nfloat32 omega")
    monkeypatch.setitem(MESSAGES, "Twist", changed)
    assert hash_now("Twist") != twist
    assert hash_now("State") != state  # it has a twist


def test_standard_messages_are_those_of_ros() -> None:
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    theirs, ours = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.EMPTY)
    for name in standard._STANDARD:
        text = ros.msg_text(MESSAGES[name])
        ours.register(get_types_from_msg(text, ros.ros_name(name)))
    for name in standard._STANDARD:
        full = ros.ros_name(name)
        assert ours.hash_rihs01(full) == theirs.hash_rihs01(full), name


@pytest.mark.parametrize("name", ["Tick", "HostTick", "Truth"])
def test_a_row_is_read_by_name(name: str) -> None:
    layout = Layout(name, {one.name: 3 for one in MESSAGES[name].sequences})
    rows = layout.rows(2)
    for part in layout.parts:
        rows.counts(part)["valid"] = 2
    found = cdr.decode(MESSAGES[name], rows.message(1))
    for part in layout.parts:
        assert found[f"{part.field.name}_valid"] == 2
        assert len(found[part.field.name]) == 3
    assert name in DTYPES


def test_a_form_packs_other_numbers_beside_the_same_texts() -> None:
    kind, header = "geometry_msgs/WrenchStamped", {"frame_id": "sat12"}
    form = cdr.Form(kind, {"header": header})
    for numbers in ((7, 8, 0.5, -1.0, 0.0, 0.0, 0.0, 2.5), (1, 2, *range(6))):
        sec, nanosec, fx, fy, fz, tx, ty, tz = numbers
        stamp = {"sec": sec, "nanosec": nanosec}
        wrench = {
            "force": {"x": fx, "y": fy, "z": fz}, "torque": {"x": tx, "y": ty, "z": tz},
        }  # fmt: skip
        message = {"header": header | {"stamp": stamp}, "wrench": wrench}
        assert form.pack(*numbers) == cdr.encode(kind, message)
    with pytest.raises(ValueError, match="argument 2 is shorter"):
        form.pack(1, 2)


def test_only_some_numbers_of_a_record_are_unpacked() -> None:
    size = struct.calcsize("<4x" + form("Tick"))
    data = bytes(k % 120 for k in range(size))
    every = dict(zip(leaves("Tick"), struct.unpack_from("<4x" + form("Tick"), data), strict=True))
    for names in (("outputs.fault", "outputs.response"), ("inputs.t",), tuple(leaves("Tick"))):
        assert only("Tick", *names).unpack_from(data) == tuple(every[one] for one in names)
