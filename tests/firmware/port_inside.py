"""What is wrong inside an image: its copies of memory, its rings, its masks of interrupts.

The names of functions and variables are from the ELF file beside the image.
"""

import subprocess

import unicorn
from unicorn import arm_const as arm

from firmware_interface.frame import Decoder, encode_message
from firmware_interface.messages import Ack, Hello, Ping
from firmware_interface.stm32 import (
    FLASH,
    LANDING,
    RAM,
    TXE,
    USART1_DR,
    USART1_SR,
    WFI,
    WRAP,
    Machine,
)

SPARE = RAM + 0x1_C000  # memory that the image does not use
STAMP = 8  # offset in `received`


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
    late = type("Late", (Guarded,), {"every": 1, "closed_until_us": 2_000_000})(path)
    late.run_until(2_500_000)
    decoder = Decoder()
    frames = decoder.feed(bytes(late.sent))
    if decoder.bad or len(frames) < 10:
        return "frames that wait for the line"
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


def wrong_inside(path):
    """The first thing that is wrong; empty: nothing."""
    names = symbols(path)
    return copies_of(path, names) or rings_of(path, names) or masks_of(path)
