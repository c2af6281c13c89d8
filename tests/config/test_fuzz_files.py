"""Every file that an experiment or a campaign is made of, with rubbish in it: one clear error.

ABT_FUZZ is the number of files of each kind times sixty, ABT_ROUND the seed; `make fuzz` sets them.
"""

import os
import shutil
import tracemalloc

import numpy as np
import pytest

from growth import in_use
from testbed.campaign.benchmark import load_benchmark
from testbed.campaign.sweep import load_campaign
from testbed.campaign.tuning import load_tuning
from testbed.config import SHIPPED, ConfigError, Experiment, load
from testbed.reproduction.paper import read_paper

COUNT = int(os.environ.get("ABT_FUZZ", "9000")) // 60
ROUND = int(os.environ.get("ABT_ROUND", "0"))
TOKENS = [
    b"nan", b"inf", b"-1", b"0", b"1e308", b"true", b'""', b"[]", b"{}", b"[[]]", b'"x"', b"\x00",
    b"\xff\xfe", b"= =", b"[a.b.c]", b"[[x]]", b"99999999999999999999", b"1979-05-27", b"'", b'"""',
    b"\n", b"#",
]  # fmt: skip


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """All that is shipped, in a folder of its own."""
    folder = tmp_path_factory.mktemp("shelf") / "configs"
    shutil.copytree(SHIPPED, folder, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def spoilt(rng, text):
    data = bytearray(text)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data)))
        sort = rng.random()
        if sort < 0.5:  # the value of some line
            at = data.find(b"=", at) + 1
            end = data.find(b"\n", at)
            data[at:end] = b" " + TOKENS[rng.integers(len(TOKENS))]
        elif sort < 0.7:
            data[at : at + int(rng.integers(30))] = TOKENS[rng.integers(len(TOKENS))]
        elif sort < 0.85:
            del data[at : data.find(b"\n", at)]
        else:
            data[at] ^= 1 << int(rng.integers(8))
    return bytes(data)


def with_faults(path):
    return load(path, [f'faults="{path.parents[1] / "faults.toml"}"'])


FILES = {
    "vehicles/generic_8jet.toml": ("experiments/hold.toml", load),
    "tables/marble_6m.toml": ("experiments/hold.toml", load),
    "faults.toml": ("experiments/hold.toml", with_faults),
    "campaigns/hold_gains.toml": ("campaigns/hold_gains.toml", load_campaign),
    "campaigns/tune_hold_pd.toml": ("campaigns/tune_hold_pd.toml", load_tuning),
    "benchmark.toml": ("benchmark.toml", load_benchmark),
    "papers/zhang2023.toml": ("papers/zhang2023.toml", read_paper),
    "scenarios/formation.toml": ("scenarios/formation.toml", load),
}


@pytest.mark.parametrize("name", FILES)
def test_a_spoilt_file(name, shelf):
    rng = np.random.default_rng((ROUND, len(name)))
    entry, read = FILES[name]
    whole = (shelf / name).read_bytes()
    refused = 0
    try:
        assert read(shelf / entry) is not None  # as it is shipped
        tracemalloc.start()
        for number in range(COUNT):
            (shelf / name).write_bytes(spoilt(rng, whole))
            try:
                got = read(shelf / entry)
                assert read is not load or isinstance(got, Experiment)
            except ConfigError as error:
                refused += 1
                said = str(error)
                if len(said) > 1500 or not said.replace("\n", "").isprintable():
                    pytest.fail(said)
            if number == COUNT // 2:
                before = in_use()
        after = in_use()
    finally:
        tracemalloc.stop()
        (shelf / name).write_bytes(whole)
    assert refused > 0.3 * COUNT
    assert after - before < 3_000_000  # [bytes]; laws that are asked for are kept
