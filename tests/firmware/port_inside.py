"""What is wrong inside an image: its copies of memory, its rings, its masks of interrupts.

The names of functions and variables are from the ELF file beside the image.
"""

import subprocess
import zlib

import unicorn
from unicorn import arm_const as arm

from firmware_interface.frame import CODED_MAX, Decoder, encode_message
from firmware_interface.messages import Ack, Hello, Ping, ResetCause
from firmware_interface.stm32 import (
    CPSIE_I,
    FLASH,
    GPIOC_BSRR,
    ISB,
    LANDING,
    NVIC_ISPR0,
    RAM,
    RNG_DR,
    RNG_SR,
    TXE,
    USART1_DR,
    USART1_SR,
    WFI,
    WRAP,
    Machine,
)

SPARE = RAM + 0x1_C000  # memory that the image does not use
STAMP = 8  # offset in `received`
PROBES = (0x600D_F00D, 0x0DD5_EED5)  # values of `told`, a variable that only these images have
KEPT = 64  # bytes that survive resets: the count of boots, then noise
RANDOM = 5
SEND_RING, FRAME_MAX = 512, CODED_MAX + 1  # bytes for the line; of the longest frame
RCC_AHB1ENR = 0x4002_3830
CPSID_I = b"\x72\xb6"


def symbols(path):
    """Addresses of functions and variables."""
    listing = ["arm-none-eabi-nm", str(path.with_name("elf"))]
    lines = subprocess.run(listing, capture_output=True, check=True, text=True).stdout.splitlines()
    return {words[2]: int(words[0], 16) for words in map(str.split, lines) if len(words) == 3}


def called(machine, at, *arguments):
    """Call a function of the image; returns its result."""
    uc = machine._uc
    for register, value in zip(
        (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2), arguments, strict=False
    ):
        uc.reg_write(register, value)
    uc.reg_write(arm.UC_ARM_REG_LR, LANDING | 1)
    uc.emu_start(at | 1, LANDING, count=10_000)
    return uc.reg_read(arm.UC_ARM_REG_R0)


def copies_of(path, names):
    """memcpy and memset, as C99 7.21 has them; the compiler may call them anywhere."""
    data = bytes(range(1, 41))
    for count in (0, 1, 2, 7, 40):
        machine = Machine(path)
        uc = machine._uc
        uc.mem_write(SPARE, data)
        uc.mem_write(SPARE + 100, bytes(60))
        back = called(machine, names["memcpy"], SPARE + 100, SPARE, count)
        wanted = data[:count] + bytes(60 - count)
        if back != SPARE + 100 or bytes(uc.mem_read(SPARE + 100, 60)) != wanted:
            return f"memcpy of {count} bytes"
        back = called(machine, names["memset"], SPARE + 100, 0x1AB, count)
        wanted = bytes([0xAB] * count + [0] * (60 - count))
        if back != SPARE + 100 or bytes(uc.mem_read(SPARE + 100, 60)) != wanted:
            return f"memset of {count} bytes"
    return ""


class Guarded(Machine):
    """Notes a byte that is sent where it may be lost: too soon, or by two senders at once."""

    every = 4  # the transmit register is free at every so many looks
    closed_until_us = 0  # and not before this

    def __init__(self, path):
        self.looks, self.free, self.broken = 0, False, ""
        super().__init__(path)

    def _load(self, uc, offset, size, start):
        value = super()._load(uc, offset, size, start)
        if start + offset == USART1_SR:
            self.looks += 1
            self.free = bool(value & TXE) and self.looks % self.every == 0
            return value if self.free else value & ~TXE
        return value

    def _line_flags(self):
        flags = super()._line_flags()
        return flags & ~TXE if self.now_us < self.closed_until_us else flags

    def _store(self, uc, offset, size, value, start):
        if start + offset == USART1_DR:
            if not self.free:
                self.broken = "a byte is sent before the register is free"
            if not self._in_handler and not uc.reg_read(arm.UC_ARM_REG_PRIMASK):
                self.broken = "the main loop sends while the line's interrupt may"
            self.free = False
        super()._store(uc, offset, size, value, start)


def word(machine, at):
    return int.from_bytes(machine._uc.mem_read(at, 4), "little")


def rings_of(path, names):
    """A slow and a closed line; counters that wrap; stamps that only a received byte changes."""
    machine = Guarded(path)
    machine.run_until(300_000)
    if machine.broken:
        return machine.broken
    if word(machine, names["received"] + STAMP):
        return "a stamp without a byte"
    for begin in (0, WRAP - 256):
        late = type("Late", (Guarded,), {"every": 1, "closed_until_us": 2_000_000})(path)
        if begin:  # the counters wrap while the ring is full
            late._uc.mem_write(names["to_send"], 2 * begin.to_bytes(4, "little"))
        late.run_until(2_500_000)
        if late.broken:
            return late.broken
        decoder = Decoder()
        frames = decoder.feed(bytes(late.sent))
        if decoder.bad or len(frames) < 10:
            return "frames that wait for the line"
    for free in (FRAME_MAX, FRAME_MAX - 1):
        late = type("Late", (Guarded,), {"closed_until_us": 2_000_000})(path)
        late._uc.mem_write(names["to_send"], bytes(8))
        late._uc.mem_write(names["to_send"], (SEND_RING - free).to_bytes(4, "little"))
        late.run_until(300_000)
        if (word(late, names["to_send"]) == SEND_RING - free) != (free < FRAME_MAX):
            return f"a frame into {free} free bytes"
    ping = encode_message(Ping(), 9, 5)
    machine = Machine(path)
    machine.run_until(1_000)
    machine.sent.clear()
    begin = (WRAP - 8).to_bytes(4, "little")
    for at in ("received", "to_send"):  # `in`, then `out`
        machine._uc.mem_write(names[at], begin + begin)
    for _ in range(3):
        machine.feed(ping)
    decoder = Decoder()
    found = [frame for frame in decoder.feed(bytes(machine.sent)) if frame.type == Ack.CODE]
    if decoder.bad or len(found) != 3:
        return "rings whose counters wrap"
    return ""


def masks_of(path):
    """Sleep begins with interrupts off, or one between the last look and the sleep is missed."""
    machine, wrong = Machine(path), []

    def look(uc, address, size, _):
        if machine._code(address) == WFI and not uc.reg_read(arm.UC_ARM_REG_PRIMASK):
            wrong.append(address)

    machine._uc.hook_add(unicorn.UC_HOOK_CODE, look, None, FLASH, FLASH + 0x1_0000)
    machine._uc.ctl_flush_tb()
    machine.feed(encode_message(Hello(7), 1, 0))
    machine.run_until(machine.now_us + 20_000)
    return "the board falls asleep with interrupts on" if wrong else ""


def sleep_of(path, names):
    """What comes between the last look and the sleep is not slept over; interrupts come back on."""
    sleep = FLASH + path.read_bytes().find(WFI + CPSIE_I)  # not that of a fault
    for what in ("received", "runs"):
        machine, seen = Machine(path), {"wrong": ""}

        def look(uc, address, size, _, machine=machine, seen=seen, at=names[what]):
            off = uc.reg_read(arm.UC_ARM_REG_PRIMASK)
            if address == sleep and "came" in seen and "passed" not in seen:
                seen["wrong"] = "the board sleeps over a byte or a run"
            if address == sleep:
                seen["gate"] = seen["off"]
            if machine._code(address) == CPSID_I:
                seen["off"] = address
            if address == seen.get("gate") and "came" in seen:
                seen["passed"] = True
                seen["wrong"] = seen["wrong"] or ("interrupts stay off" if off else "")
            elif address == seen.get("gate"):
                uc.mem_write(at, (word(machine, at) + 1).to_bytes(4, "little"))
                seen["came"] = True

        machine._uc.hook_add(unicorn.UC_HOOK_CODE, look, None, FLASH, FLASH + 0x1_0000)
        machine._uc.ctl_flush_tb()
        machine.run_until(machine.now_us + 10_000)
        if seen["wrong"] or "passed" not in seen:
            return seen["wrong"] or "the main loop does not come round"
    return ""


class Unready(Machine):
    """The random generator is ready at the third look."""

    looks, soon, read = 0, False, False

    def _load(self, uc, offset, size, start):
        if start + offset == RNG_SR:
            self.looks += 1
            return int(self.looks > 2)
        self.read |= start + offset == RNG_DR and size == 4
        self.soon |= start + offset == RNG_DR and self.looks < 3
        return super()._load(uc, offset, size, start)


class Fickle(Machine):
    """A random generator that may not work."""

    ready = True

    def _load(self, uc, offset, size, start):
        if start + offset == RNG_SR and not self.ready:
            return 0
        return super()._load(uc, offset, size, start)


def kept_of(path, names):
    """Boot copies variables with a value; of what survives it changes the count and two words."""
    machine = Fickle(path)
    if any(word(machine, names["told"] + 4 * k) != probe for k, probe in enumerate(PROBES)):
        return "variables with a value"
    at = next(address for name, address in names.items() if name.startswith("kept"))
    for ready in (True, False):
        machine._uc.mem_write(at, bytes(range(KEPT)))
        before = [word(machine, at + k) for k in range(0, KEPT, 4)]
        machine._random, machine.ready = RANDOM, ready
        machine.reset(ResetCause.PIN)
        before[0] += 1
        before[1] ^= RANDOM if ready else 0
        told = b"".join(one.to_bytes(4, "little") for one in before)
        before[2] = zlib.crc32(told)
        if [word(machine, at + k) for k in range(0, KEPT, 4)] != before:
            return "what survives a reset"
    return ""


class Waits(Machine):
    """What has to happen between two accesses to registers."""

    def __init__(self, path):
        self.clocked, self.barrier = None, True
        super().__init__(path)

    def _load(self, uc, offset, size, start):
        if start + offset == RCC_AHB1ENR and self.clocked is False:
            self.clocked = True
        return super()._load(uc, offset, size, start)

    def _store(self, uc, offset, size, value, start):
        at = start + offset
        if at == RCC_AHB1ENR and self.clocked is None:
            self.clocked = False
        if at == GPIOC_BSRR and self.clocked is False:
            self.clocked = 0
        if at == NVIC_ISPR0:
            behind = uc.reg_read(arm.UC_ARM_REG_PC) - FLASH
            self.barrier = self.barrier and ISB in self._image[behind : behind + 16]
        super()._store(uc, offset, size, value, start)


def waits_of(path):
    """The clock of a port takes two cycles; a triggered interrupt is taken behind a barrier."""
    machine = Waits(path)
    if machine.clocked is not True:
        return "port C before its clock runs"
    machine.feed(encode_message(Ping(), 9, 5))
    return "" if machine.barrier else "an interrupt that is triggered and not waited for"


def wrong_inside(path):
    """The first thing that is wrong; empty: nothing."""
    names = symbols(path)
    generator = Unready(path)
    if generator.soon or not generator.read:
        return "the random generator is read before it is ready (RM0090 24.3.1)"
    return (
        copies_of(path, names)
        or rings_of(path, names)
        or masks_of(path)
        or sleep_of(path, names)
        or kept_of(path, names)
        or waits_of(path)
    )
