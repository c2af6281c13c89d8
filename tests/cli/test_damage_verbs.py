"""Every verb works on what is left of a damaged log and says what is missing."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

VERBS = (
    ["log"], ["log", "--json"], ["replay"], ["report"], ["compare"],
    ["export", "--to", "csv"], ["export", "--to", "npz", "--out", "arrays"],
)  # fmt: skip


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> Path:
    """A run of two seconds, a chunk for each tick, as in real time."""
    from click.testing import CliRunner

    from testbed.cli.main import main

    out = tmp_path_factory.mktemp("flown") / "out"
    CliRunner().invoke(main, ["run", "hold", "duration_s=2", "--speed", "50", "--out", str(out)])
    return out


@pytest.fixture
def put(flown, tmp_path, monkeypatch):
    """The run in the current folder, with another log and as its flight left it."""
    monkeypatch.chdir(tmp_path)

    def put(content: bytes, *, judged: bool = True) -> None:
        for path in tmp_path.iterdir():
            shutil.rmtree(path)
        Path("out").mkdir()
        names = ("config.toml", "metrics.json") if judged else ("config.toml",)
        for name in names:
            shutil.copy(flown / name, "out")
        Path("out/log.mcap").write_bytes(content)

    return put


def hurt(content: bytes, part: float) -> bytes:
    """One bit of the chunk at this part of the file is flipped."""
    at = content.index(b"zstd", int(part * len(content))) + 60
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


@pytest.mark.parametrize("judged", [True, False])
def test_every_verb_reads_what_is_left(testbed, flown, put, judged):
    content = (flown / "log.mcap").read_bytes()
    put(hurt(content, 0.5), judged=judged)
    for verb, *options in VERBS:
        result = testbed(verb, "out", *options)
        assert result.exit_code == 0, result.output
        assert result.stderr.count("of flight (") == 1
        assert "warning: out/log.mcap is damaged at byte " in result.stderr


def test_the_log_verb_lists_the_damage(testbed, flown, put):
    put(hurt((flown / "log.mcap").read_bytes(), 0.5))
    contents = json.loads(testbed("log", "out", "--json").stdout)
    assert contents["finished"] is True
    assert len(contents["damage"]) == 1
    assert "damaged at byte" in contents["damage"][0]


def test_a_replay_compares_up_to_the_damage_and_says_so(testbed, flown, put):
    put(hurt((flown / "log.mcap").read_bytes(), 0.5))
    result = testbed("replay", "out")
    assert "bit-exact: " in result.stdout
    assert ", up to the damage" in result.stdout
    verdict = json.loads(testbed("replay", "out", "--json").stdout)
    assert verdict["whole"] is False
    assert 0 < verdict["ticks"] < 40
    put(hurt((flown / "log.mcap").read_bytes(), 0.0))
    result = testbed("replay", "out")
    assert result.exit_code == 2
    assert "found     damage before the first tick" in result.stderr


def test_nothing_left_is_bad_input(testbed, flown, put):
    content = (flown / "log.mcap").read_bytes()
    put(content[:60] + bytes(len(content) - 60), judged=False)
    for verb, *options in VERBS[2:]:
        result = testbed(verb, "out", *options)
        assert result.exit_code == 2, (verb, result.output)
        assert "the flight is missing" in result.stderr


def damaged(content: bytes, rng: np.random.Generator):
    for _ in range(3):
        at = int(rng.integers(len(content)))
        yield content[:at] + bytes(len(content) - at)
        at = int(rng.integers(len(content) - 4096))
        yield content[:at] + bytes(4096) + content[at + 4096 :]
        at = int(rng.integers(len(content)))
        yield content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :]
        yield content[: int(rng.integers(len(content)))]


def test_no_damage_is_this_software_s_failure(testbed, flown, put):
    copies = damaged((flown / "log.mcap").read_bytes(), np.random.default_rng(7))
    for k, content in enumerate(copies):
        put(content, judged=k % 2 == 0)
        for verb, *options in VERBS:
            assert testbed(verb, "out", *options).exit_code in (0, 2)
