"""Building what gets flashed."""

import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from firmware_interface import compiler
from firmware_interface.compiler import image
from firmware_interface.limits import config_hash, limits_of
from testbed.core.vehicle import Vehicle

pytestmark = pytest.mark.usefixtures("a_cross_compiler")

ROOT = Path(__file__).parents[2]
FLOATER = ROOT / "configs" / "vehicles" / "generic_8jet.toml"


@pytest.fixture
def limits(host):
    return host.limits


def build(*arguments, path=None):
    return subprocess.run(
        [sys.executable, "-m", "firmware_interface.compiler", *map(str, arguments)],
        capture_output=True, text=True, check=False, cwd=ROOT, env=path and {"PATH": path},
    )  # fmt: skip


def test_a_vehicle_file_becomes_an_image_with_its_limits(tmp_path):
    result = build(FLOATER, tmp_path / "out")
    assert result.returncode == 0, result.stderr
    limits = limits_of(msgspec.toml.decode(FLOATER.read_bytes(), type=Vehicle))
    assert f"limits {config_hash(limits):08x}" in result.stdout
    flat = (tmp_path / "out" / "generic_8jet.bin").read_bytes()
    assert 4_000 < len(flat) < 16_384
    assert int.from_bytes(flat[:4], "little") == 0x2000_2000  # the stack, at the bottom of RAM


def test_the_same_sources_give_the_same_bytes(limits, tmp_path, monkeypatch):
    flat = []
    for name in "ab":
        monkeypatch.setattr(compiler, "CACHE", tmp_path / name)
        flat.append(image(limits).with_suffix(".bin").read_bytes())
    assert flat[0] == flat[1]


def test_other_limits_give_another_image(limits):
    other = msgspec.structs.replace(limits, dead_us=limits.dead_us + 1)
    assert image(limits) != image(other)


def test_it_fits_with_room_to_spare(limits):
    elf = image(limits)
    size = subprocess.run(
        ["arm-none-eabi-size", elf], capture_output=True, text=True, check=True
    ).stdout.splitlines()[1]
    text, data, bss = (int(word) for word in size.split()[:3])
    assert text + data < 16_384
    assert data + bss < 16_384  # of 131 072, the stack's 8192 included


@pytest.mark.parametrize("arguments", [(), (FLOATER,)])
def test_missing_arguments_print_the_usage(arguments):
    result = build(*arguments)
    assert (result.returncode, result.stdout) == (2, "")
    assert "VEHICLE FOLDER" in result.stderr


def test_a_file_that_is_no_vehicle_is_named(tmp_path):
    result = build(ROOT / "pyproject.toml", tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("error: ")


def test_without_a_cross_compiler_the_error_says_what_to_install(tmp_path):
    assert shutil.which("gcc")  # the native one does not help
    result = build(FLOATER, tmp_path, path=str(tmp_path))
    assert result.returncode == 2
    assert "apt install --no-install-recommends gcc-arm-none-eabi" in result.stderr
