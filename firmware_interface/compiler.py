"""Build the firmware for this machine and for the board's chip, once per version of its sources.

    python -m firmware_interface.compiler VEHICLE FOLDER

builds the image of a vehicle's board and copies it to a folder, for flashing.

Builds are cached under ~/.cache/airbearing-testbed, named by a hash of sources, flags and compiler,
so a stale build is never loaded and no cleaning is necessary.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec

from firmware_interface.limits import LimitsError, board_header, config_hash, limits_of
from firmware_interface.messages import Config
from testbed.core.error import TestbedError
from testbed.core.vehicle import Vehicle

FIRMWARE = Path(__file__).with_name("firmware")
CORE = tuple(sorted((FIRMWARE / "core").glob("*.c")))
WARNINGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror"),
    f"-I{FIRMWARE / 'core'}",
)
CHIP_FLAGS = (
    *("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=soft", "-O2", "-g", "-ffreestanding"),
    *("-fno-tree-loop-distribute-patterns", "-ffunction-sections", "-nostdlib"),
    *("-Wl,--gc-sections", "-Wl,--fatal-warnings"),
)
CACHE = Path.home() / ".cache" / "airbearing-testbed"


class CompilerError(TestbedError):
    """The firmware cannot be built on this machine."""


def compiler() -> str:
    """The C compiler: $CC, gcc or cc.

    Raises:
        CompilerError: no C compiler found.
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


def _named(sources: Sequence[Path], command: Sequence[str], extra: str = "") -> str:
    """Cache name of a build: a hash of sources, flags and compiler."""
    version = subprocess.run([command[0], "--version"], capture_output=True, check=True).stdout
    digest = hashlib.sha256(repr((version, tuple(command), extra)).encode())
    for path in sorted({*sources, *FIRMWARE.rglob("*.h")}):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:20]


def _run(command: Sequence[str | Path]) -> str:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise CompilerError(f"{' '.join(map(str, command))} failed:\n{result.stderr}")
    return result.stdout


def build(sources: Sequence[Path], flags: Sequence[str], suffix: str) -> Path:
    """Compile and link `sources` for this machine; returns the file in the cache.

    Raises:
        CompilerError: no compiler, or it failed; the message contains its output.
    """
    command = [compiler(), *WARNINGS, *flags]
    target = CACHE / f"{_named(sources, command)}{suffix}"
    if not target.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=CACHE) as folder:
            built = Path(folder) / "built"
            _run([*command, *sources, "-o", built])
            built.replace(target)  # atomic: another process may build the same file
    return target


def shared_library() -> Path:
    """Build the core as a shared library for virtual time."""
    host = FIRMWARE / "host" / "inproc.c"
    return build((*CORE, host), ("-O2", "-g", "-shared", "-fPIC"), ".so")


def host_program() -> Path:
    """Build the core as a program on a pseudo-terminal."""
    return build((*CORE, FIRMWARE / "host" / "pty.c"), ("-O2", "-g"), "")


def cross_compiler() -> str:
    """The compiler for the board's chip; no C library needed.

    Raises:
        CompilerError: no cross-compiler found.
    """
    if found := shutil.which("arm-none-eabi-gcc"):
        return found
    raise CompilerError(
        "arm-none-eabi-gcc not found: it builds the image for the board's chip; on Debian"
        " `apt install --no-install-recommends gcc-arm-none-eabi`"
    )


def image(config: Config, timer: str = "tim2", flags: Sequence[str] = ()) -> Path:
    """The firmware of a board with these limits, for an STM32F405: an ELF file in the cache.

    The same image for flashing, a .bin file, is next to it.

    Args:
        config: limits, see `limits.limits_of`.
        timer: "tim2", or "systick" for QEMU.
        flags: additional compiler flags, such as -DCRYSTAL_MHZ=12u.

    Raises:
        CompilerError: no cross-compiler, or it failed.
    """
    chip = FIRMWARE / "stm32f4"
    script = chip / "stm32f405.ld"
    sources = (*CORE, *(chip / f"{n}.c" for n in ("startup", "main", f"timer_{timer}")))
    header = board_header(config)
    command = [
        *(cross_compiler(), *WARNINGS, *CHIP_FLAGS, *flags, f"-I{chip}", f"-T{script}"),
        f"-DABT_FIRMWARE_ID={firmware_id():#x}u",
    ]
    target = CACHE / f"{_named((*sources, script), command, header)}.elf"
    if not target.with_suffix(".bin").exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=CACHE) as folder:
            elf, flat = Path(folder) / "elf", Path(folder) / "bin"
            (Path(folder) / "abt_board_config.h").write_text(header)
            _run([*command, f"-I{folder}", *sources, "-lgcc", "-o", elf])
            _run(["arm-none-eabi-objcopy", "-O", "binary", elf, flat])
            elf.replace(target)
            flat.replace(target.with_suffix(".bin"))
    return target


def _install(vehicle: Path, folder: Path) -> None:
    """Build for a vehicle file and copy the image to `folder`."""
    config = limits_of(msgspec.toml.decode(vehicle.read_bytes(), type=Vehicle))
    folder.mkdir(parents=True, exist_ok=True)
    built = image(config)
    for suffix in (".elf", ".bin"):
        target = folder / f"{vehicle.stem}{suffix}"
        shutil.copyfile(built.with_suffix(suffix), target)
        print(target)  # noqa: T201
    print(f"limits {config_hash(config):08x}, firmware {firmware_id():08x}")  # noqa: T201


def _main() -> int:
    if len(sys.argv) != 3:
        sys.stderr.write("usage: python -m firmware_interface.compiler VEHICLE FOLDER\n")
        return 2
    try:
        _install(Path(sys.argv[1]), Path(sys.argv[2]))
    except (CompilerError, LimitsError, OSError, msgspec.DecodeError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(_main())
