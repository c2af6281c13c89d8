"""Build the firmware for this machine, once per state of its sources.

The result is kept under ~/.cache/airbearing-testbed, named by a hash of sources, flags and
compiler, so that nothing stale is ever loaded and nobody has to clean up.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

FIRMWARE = Path(__file__).with_name("firmware")
CORE = tuple(sorted((FIRMWARE / "core").glob("*.c")))
WARNINGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror"),
    f"-I{FIRMWARE / 'core'}",
)
CACHE = Path.home() / ".cache" / "airbearing-testbed"


class CompilerError(Exception):
    """The firmware cannot be built on this machine."""


def compiler() -> str:
    """The C compiler: $CC, gcc or cc.

    Raises:
        CompilerError: there is none.
    """
    for name in (os.environ.get("CC"), "gcc", "cc"):
        if name and (found := shutil.which(name)):
            return found
    raise CompilerError(
        "no C compiler found (looked for $CC, gcc and cc): the firmware board is built from its"
        " sources; on Debian `apt install gcc libc6-dev`, or choose the modelled board"
    )


def firmware_id() -> int:
    """First 32 bits of the hash of the core's sources."""
    digest = hashlib.sha256()
    for path in sorted((FIRMWARE / "core").iterdir()):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return int.from_bytes(digest.digest()[:4], "big")


def build(sources: Sequence[Path], flags: Sequence[str], suffix: str) -> Path:
    """Compile and link `sources`; the file in the cache.

    Raises:
        CompilerError: no compiler, or it refuses; its words are in the message.
    """
    cc = compiler()
    version = subprocess.run([cc, "--version"], capture_output=True, check=True).stdout
    digest = hashlib.sha256(repr((cc, version, tuple(flags))).encode())
    for path in sorted({*sources, *FIRMWARE.rglob("*.h")}):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    target = CACHE / f"{digest.hexdigest()[:20]}{suffix}"
    if target.exists():
        return target
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        built = Path(folder) / "built"
        command = [cc, *WARNINGS, *flags, *map(str, sources), "-o", str(built)]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode:
            raise CompilerError(f"{' '.join(command)} failed:\n{result.stderr}")
        built.replace(target)  # atomic: another process may be doing the same
    return target


def shared_library() -> Path:
    """The core with its frame for virtual time."""
    host = FIRMWARE / "host" / "inproc.c"
    return build((*CORE, host), ("-O2", "-g", "-shared", "-fPIC"), ".so")


if __name__ == "__main__":
    print(shared_library())  # noqa: T201
