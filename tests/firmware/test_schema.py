"""messages.toml is the one home of the messages, and a version means what it meant."""

import json
import shutil
import subprocess

import msgspec
import pytest

from firmware_interface import generate, published
from firmware_interface.frame import Decoder
from firmware_interface.messages import TYPES
from firmware_interface.schema import SOURCE, SchemaError, read

TEXT = SOURCE.read_text()


def test_the_header_is_what_messages_toml_says():
    assert generate.HEADER.read_text() == generate.header(read(TEXT))


def test_the_module_is_what_messages_toml_says():
    assert generate.MODULE.read_text() == generate.formatted(generate.module(read(TEXT)))


# Versions


def test_this_version_is_what_was_published():
    published.check(read(TEXT))


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
        ('from = "host"\ndoc = "Close', 'from = "board"\ndoc = "Close'),
    ],
)
def test_a_changed_field_needs_a_new_version(old, new):
    assert TEXT.count(old) >= 1
    with pytest.raises(SchemaError, match=r"differs from version 2 as published.*raise `version`"):
        published.check(read(TEXT.replace(old, new, 1)))


def test_words_may_change_without_one():
    published.check(read(TEXT.replace("What the board may do.", "Other words.")))


@pytest.fixture
def golden(tmp_path):
    """A copy of what was published, to be tampered with."""
    for path in published.GOLDEN.glob("version_*.json"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


CHANGED = TEXT.replace("max = 60_000", "max = 60_001")


def test_a_record_rewritten_to_fit_the_fields_is_noticed(golden):
    """The easy way out when the test above fails, and the one that must not work."""
    published.path_of(2, golden).unlink()
    published.publish(read(CHANGED), golden)
    with pytest.raises(
        SchemaError, match=r"version_2\.json differs from what was published.*restore it"
    ):
        published.check(read(CHANGED), golden)


def next_version(golden):
    text = CHANGED.replace("version = 2 ", "version = 3 ")
    assert text != CHANGED
    return text.replace(read(TEXT).sealed, published.publish(read(text), golden))


def test_a_new_version_is_published_once(golden):
    text = CHANGED.replace("version = 2 ", "version = 3 ")
    with pytest.raises(SchemaError, match="version 3 of the messages is not published"):
        published.check(read(text), golden)
    text = next_version(golden)
    published.check(read(text), golden)
    with pytest.raises(SchemaError, match="version 3 is already published"):
        published.publish(read(text), golden)
    frames = json.loads(published.path_of(3, golden).read_text())["frames"]
    assert {frame["message"] for frame in frames} == {kind.__name__ for kind in TYPES.values()}


def test_its_golden_frames_are_read_by_other_code_than_wrote_them(golden):
    next_version(golden)
    for one in json.loads(published.path_of(3, golden).read_text())["frames"]:
        (frame,) = Decoder().feed(bytes.fromhex(one["hex"]))
        fields = msgspec.to_builtins(frame.message)
        assert json.loads(json.dumps(fields)) == one["fields"]


def test_an_older_version_stays_sealed(golden):
    text = next_version(golden)
    path = published.path_of(1, golden)
    path.write_text(path.read_text().replace("state.ARMED 2", "state.ARMED 3"))
    with pytest.raises(SchemaError, match=r"version_1\.json differs from what was published"):
        published.check(read(text), golden)


def test_git_knows_what_was_published_as_added_only(need_tool):
    """Whoever rewrites record and seal together is caught by history."""

    def git(*words):
        return subprocess.run(
            ["git", "-C", published.GOLDEN, *words], capture_output=True, text=True, check=False
        )

    missing = not shutil.which("git") or git("rev-parse", "--git-dir").returncode
    need_tool("not a git checkout" if missing else None)
    for since in (("log", "-m", "--format=%h"), ("diff", "HEAD")):
        rewritten = git(*since, "--diff-filter=MDT", "--name-only", "--", "version_*.json")
        assert (rewritten.returncode, rewritten.stdout) == (0, ""), rewritten.stderr


def test_two_messages_cannot_share_a_code():
    with pytest.raises(SchemaError, match="share a code"):
        read(TEXT.replace("code = 4\n", "code = 1\n"))


def test_an_unknown_type_is_named():
    with pytest.raises(SchemaError, match=r"cmd.age_us has an unknown type: 'u64'"):
        read(TEXT.replace('["age_us", "u32"', '["age_us", "u64"'))
