"""Codes and their words: every code has words, and a report survives network and log."""

import string

import msgspec
import pytest

from testbed.config.shipped import shipped_faults
from testbed.core.codes import (
    LATCHED,
    Code,
    Detector,
    FaultId,
    FaultReport,
    Hazard,
    InhibitReason,
    Intervention,
    Refusal,
    Response,
)
from testbed.core.records.cdr import decode
from testbed.core.records.definition import MESSAGES
from testbed.core.records.kinds import EventKind
from testbed.flight.faults import Fault
from testbed.logs.row_reader import fault_of
from testbed.logs.tick_row import event_of
from testbed.net.commands import Lease

CODES = [one for kind in Code.__subclasses__() for one in kind]
TABLE = shipped_faults()


def test_every_code_has_words_of_its_own():
    assert {type(one) for one in CODES} == {Response, InhibitReason, Hazard, Detector}
    for kind in Code.__subclasses__():
        words = [one.words for one in kind]
        assert len(set(words)) == len(words)
    assert [one for one in CODES if not one.words] == [Response.NONE]


def test_codes_fit_a_byte_and_detectors_count_from_0():
    assert all(0 <= one <= 255 for one in CODES)
    assert list(Detector) == list(range(len(Detector)))


@pytest.mark.parametrize("code", InhibitReason)
def test_a_refusal_can_be_read_whatever_values_came_with_it(code):
    asked = {field for _, field, _, _ in string.Formatter().parse(code.words) if field}
    assert asked <= {"0", "1", "2"}
    for values in ((), (1.0,), (float("nan"), float("inf"), -1.0, 4.0)):
        words = Refusal(code, values).words
        assert words
        assert "{" not in words


def test_reasons_that_the_gate_latches_are_faults():
    assert {one.name for one in InhibitReason if one in LATCHED} == {
        "ESTIMATE_NOT_FINITE", "DEMAND_NOT_FINITE", "POSE_TOO_OLD", "POSES_REJECTED",
        "SETPOINT_TOO_OLD", "OUTSIDE_FENCE", "TOO_FAST", "SUPPLY_NOT_FINITE", "FAULT",
    }  # fmt: skip


def test_an_id_says_where_a_fault_is_from():
    gate = {one.name.lower() for one in InhibitReason if one in LATCHED}
    assert len({*TABLE, *gate, *FaultId}) == len(TABLE) + len(gate) + len(FaultId)


@pytest.mark.parametrize("kind", Code.__subclasses__())
def test_an_unknown_code_is_refused(kind):
    data = msgspec.msgpack.encode(200)
    with pytest.raises(msgspec.ValidationError, match="Invalid enum value 200"):
        msgspec.msgpack.decode(data, type=kind)
    with pytest.raises(msgspec.ValidationError, match="Invalid enum value 200"):
        msgspec.json.decode(b"200", type=kind)


@pytest.mark.parametrize(
    "field", [{"response": "warn of"}, {"response": "3"}, {"detector": "pose"}, {"response": ""}]
)
def test_an_unknown_name_in_the_table_is_refused(field):
    tree = msgspec.to_builtins(TABLE["pose_lost"]) | field
    with pytest.raises(msgspec.ValidationError, match="Invalid enum value"):
        msgspec.convert(tree, Fault)


@pytest.mark.parametrize("name", TABLE)
def test_the_report_of_every_row_survives_network_and_log(name):
    row = TABLE[name]
    first = FaultReport("leak", "a leak", "sat2").origin
    report = row.report(name, 1.5, "3", first if name == "fleet" else None)
    text = row.text.format(value=1.5, said="3").removeprefix(name.replace("_", " ") + ": ")
    assert report.words == f"{name}: {text}"
    lease = Lease(fleet=report)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(lease), type=Lease) == lease
    event = decode(MESSAGES["Event"], event_of(1.0, EventKind.FAULT, report))
    assert (event["id"], event["text"], fault_of(event)) == (report.id, report.words, report)


def test_words_of_a_report_begin_with_vehicle_and_row():
    row = FaultReport("leak", "a leak", "sat2", "tank_loss", 0.1, notes=("it hissed", "loudly"))
    assert row.words == "sat2: leak: a leak; it hissed; loudly"
    twice = FaultReport("pose_lost", "pose lost: no pose for 3 s", "sat2", "pose_age", 3.0)
    assert twice.words == "sat2: pose_lost: no pose for 3 s"
    assert FaultReport(FaultId.STOPPED, "stopped by the operator").words == (
        "stopped by the operator"
    )
    assert FaultReport(FaultId.LINE_LOST, "the line is lost", "sat1").title == "line lost"


def test_words_of_a_hazard_are_its_name_if_it_has_one():
    assert Intervention(0.1, 0.0, Hazard.OBSTACLE, "o1").words == "o1"
    assert Intervention(0.1, 0.0, Hazard.LEFT_EDGE).words == "the left edge"
