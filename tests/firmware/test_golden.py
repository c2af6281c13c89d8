"""Frames written down once: hex and fields, the same in C and in Python."""

import json
import subprocess
from pathlib import Path

import pytest

from firmware_interface import frame, messages
from firmware_interface.compiler import FIRMWARE, build
from firmware_interface.published import path_of

GOLDEN = json.loads(path_of(messages.VERSION).read_text())["frames"]
NAMES = [one["message"] for one in GOLDEN]


def plain(value):
    return list(value) if isinstance(value, tuple) else int(value)


def test_every_message_has_a_golden_frame():
    assert sorted(set(NAMES)) == sorted(kind.__name__ for kind in messages.TYPES.values())


@pytest.mark.parametrize("one", GOLDEN, ids=NAMES)
def test_python_reads_and_writes_it(one):
    coded = bytes.fromhex(one["hex"])
    (found,) = frame.Decoder().feed(coded)
    message = found.message
    assert type(message).__name__ == one["message"]
    assert {n: plain(getattr(message, n)) for n in message.__struct_fields__} == one["fields"]
    assert (found.seq, found.t_us, found.version) == (one["seq"], one["t_us"], one["version"])
    assert frame.encode(found) == coded
    assert frame.encode_message(message, one["seq"], one["t_us"]) == coded


def snake(name):
    return "".join("_" + c.lower() if c.isupper() else c for c in name).lstrip("_")


def c_check(one):
    """C statements that fail with the frame's name when it reads or writes something else."""
    coded, name = bytes.fromhex(one["hex"]), snake(one["message"])
    tests = [f"f.type == ABT_TYPE_{name.upper()}", f"f.seq == {one['seq']}u"]
    tests += [f"f.t_us == {one['t_us']}u", f"f.payload_size == ABT_{name.upper()}_SIZE"]
    lines = [f"static const uint8_t coded[] = {{{', '.join(map(str, coded))}}};"]
    lines += ["abt_frame f = {0}; uint8_t out[ABT_FRAME_MAX]; abt_decoder d = {0};"]
    lines += ["abt_frame_result r = ABT_FRAME_NONE;"]
    lines += ["for (size_t i = 0; i < sizeof coded; i++) { r = abt_decode(&d, coded[i], &f); }"]
    lines += ["CHECK(r == ABT_FRAME_GOOD);"]
    if one["fields"]:
        lines += [f"abt_{name} m; abt_{name}_unpack(f.payload, &m);"]
        lines += [f"abt_{name}_pack(&m, f.payload);"]
    for field, value in one["fields"].items():
        if isinstance(value, list):
            tests += [f"m.{field}[{i}] == {v}u" for i, v in enumerate(value)]
        else:
            tests.append(f"m.{field} == {value}u")
    lines += [f"CHECK({test});" for test in tests]
    lines += ["CHECK(abt_encode(&f, out) == sizeof coded);"]
    lines += ["CHECK(memcmp(out, coded, sizeof coded) == 0);"]
    return "{\n" + "\n".join(lines) + "\n}"


def test_c_reads_and_writes_them(tmp_path):
    source: Path = tmp_path / "golden.c"
    source.write_text(
        "#include <stdio.h>\n#include <string.h>\n"
        '#include "abt_frame.h"\n'
        "#define CHECK(x) do { if (!(x)) { puts(#x); bad = 1; } } while (0)\n"
        "int main(void)\n{\nint bad = 0;\n" + "\n".join(map(c_check, GOLDEN)) + "\nreturn bad;\n}\n"
    )
    program = build((FIRMWARE / "core" / "abt_frame.c", source), ("-O1",), "")
    result = subprocess.run([program], capture_output=True, text=True, check=False)
    program.unlink()
    assert (result.returncode, result.stdout) == (0, "")
