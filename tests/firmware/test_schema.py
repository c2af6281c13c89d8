"""messages.toml is the one home of the messages, and a version means what it meant."""

import pytest

from firmware_interface import generate
from firmware_interface.schema import SOURCE, SchemaError, read

TEXT = SOURCE.read_text()


def test_the_header_is_what_messages_toml_says():
    assert generate.HEADER.read_text() == generate.header(read(TEXT))


def test_the_module_is_what_messages_toml_says():
    assert generate.MODULE.read_text() == generate.formatted(generate.module(read(TEXT)))


def test_this_version_is_what_was_published():
    read(TEXT).check_version()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('["age_us", "u32"', '["age_us", "u16"'),
        ("code = 4\n", "code = 7\n"),
        ("min = 1, max = 10_000_000", "min = 1, max = 10_000_001"),
        ("names.ARMED = [2,", "names.ARMED = [3,"),
        ('["plan", "u32", "", "number', '["number", "u32", "", "number'),
        ("edges = 8 ", "edges = 9 "),
        ('["min_off_us", "u32", "us"', '["min_off_us", "u32", "ms"'),
    ],
)
def test_a_changed_field_needs_a_new_version(old, new):
    assert TEXT.count(old) >= 1
    with pytest.raises(SchemaError, match=r"raise `version` and add `2 ="):
        read(TEXT.replace(old, new, 1)).check_version()


def test_words_may_change_without_one():
    read(TEXT.replace("What the board may do.", "Other words.")).check_version()


def test_two_messages_cannot_share_a_code():
    with pytest.raises(SchemaError, match="share a code"):
        read(TEXT.replace("code = 4\n", "code = 1\n"))


def test_an_unknown_type_is_named():
    with pytest.raises(SchemaError, match=r"cmd.age_us has an unknown type: 'u64'"):
        read(TEXT.replace('["age_us", "u32"', '["age_us", "u64"'))
