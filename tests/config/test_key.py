"""Keys are written as they are read."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.config.key import ANY, assignment, printable, spell

names = st.text(min_size=1, max_size=20).filter(lambda name: name != ANY)
keys = st.tuples(names, st.lists(names | st.integers(0, 999_999), max_size=5)).map(
    lambda parts: (parts[0], *parts[1])
)


@given(keys)
def test_a_spelt_key_is_read_back(key):
    text = spell(key)
    assert printable(text) == text
    if text.isascii() and "\\x" not in text:  # TOML has no \x, an error message may
        words = tuple(str(part + 1) if isinstance(part, int) else part for part in key)
        assert assignment(f"{text} = 1") == (words, "1")


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("a=1", ("a",), "1"),
        (" a . b = 1 ", ("a", "b"), "1"),
        ("a.b-c_d.0=1", ("a", "b-c_d", "0"), "1"),
        ("a.*.*.b=1", ("a", ANY, ANY, "b"), "1"),
        ('a."b.c = d".e=1', ("a", "b.c = d", "e"), "1"),
        ("a.'b[0]'=1", ("a", "b[0]"), "1"),
        ('"\\u00e9\\t\\""=1', ('\u00e9\t"',), "1"),
        ("\u00e9=1", ("\u00e9",), "1"),
        ("a==1", ("a",), "=1"),
        ("a='x = y'", ("a",), "'x = y'"),
        ("a=[1,\n2]", ("a",), "[1,\n2]"),
    ],
)
def test_assignment(text, key, value):
    assert assignment(text) == (key, value)


def test_a_key_looks_like_toml():
    assert spell(("vehicles", "sat1", "start", 0)) == "vehicles.sat1.start.1"
    assert spell(("vehicles", "sat 1.5", "model")) == 'vehicles."sat 1.5".model'
    assert spell(("", "\x1b[31m")) == '"".' + '"\\x1b[31m"'
    assert spell(()) == ""
