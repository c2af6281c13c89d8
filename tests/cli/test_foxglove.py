"""What Foxglove is told about a flown log."""

from pathlib import Path

import pytest

from foxglove_rules import misfits, refused

FLIGHTS = [
    ["zhang2023_table"],
    ["zhang2023_table_wrench"],
    ["hold", "--speed", "100"],  # with the topic of its loop
    ["hold", "vehicles.sat1.model.mass=18.0", "table.mocap.dropout_rate=0.9"],
]


@pytest.mark.parametrize("words", FLIGHTS, ids=" ".join)
def test_every_message_fits_a_schema_that_foxglove_reads(testbed, here, read_log, words):
    testbed("run", *words, "duration_s=2", "--out", "out")
    log = read_log(Path("out"))
    assert set(log.schemas) == set(log.messages)
    for topic, (encoding, _, schema) in log.schemas.items():
        assert encoding == "jsonschema"
        assert refused(schema) == [], topic
        for _, message in log.messages[topic]:
            message.get("inputs", {}).pop("samples", None)  # lists of lists: no schema can say it
            assert misfits(schema, message) == [], topic
