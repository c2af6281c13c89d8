"""The alarm's interrupt at every instruction of what a frame causes, in the image that is flashed.

Random interrupts find next to nothing here: a gap of one instruction in ten thousand is hit by
chance about never. So the program is stepped, and at each boundary between two instructions a copy
of the chip goes on with the interrupt taken right there. Instructions take no time in this machine,
so whatever the boundary, what the pins do afterwards must be the same.

Boundaries before which nothing but registers changed are one and the same place to an interrupt,
which saves and restores them; a copy is made for the first of them only.
"""

import re
from collections import Counter

import msgspec
import pytest
import unicorn
from unicorn import arm_const as arm

from firmware_interface.compiler import CompilerError, image
from firmware_interface.frame import Decoder, encode_message
from firmware_interface.messages import Ack, Arm, Bearing, Cmd, Disarm, Hello, HelloAck
from firmware_interface.stm32 import (
    CORE,
    CORE_SIZE,
    FLASH,
    PERIPHERALS,
    PERIPHERALS_SIZE,
    RAM,
    RAM_SIZE,
    WFI,
    Machine,
)

# everything a plan does happens within half a millisecond
QUICK = {"min_on_us": 50, "min_off_us": 40, "dead_us": 20, "status_period_us": 10_000_000}
HORIZON_US = 600
SUPPLIED = (3000, 2000)  # counts of the converter: 24 V
REGISTERS = [
    *(getattr(arm, f"UC_ARM_REG_R{number}") for number in range(13)),
    *(arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR, arm.UC_ARM_REG_XPSR, arm.UC_ARM_REG_PRIMASK),
    arm.UC_ARM_REG_BASEPRI,
]


class Stepped(Machine):
    """The chip, one instruction of the main program at a time."""

    def __init__(self, path):
        self._stepping = False
        self._at = None  # the newest instruction executed
        self._block = 0  # instructions left of an IT block, which are one step
        self._long = False  # the step is such a block
        self.accesses = 0  # of memory and peripherals
        super().__init__(path, adc=SUPPLIED)
        code, data = unicorn.UC_HOOK_CODE, unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE
        self._uc.hook_add(code, self._before, None, FLASH, RAM)
        for start, size in ((RAM, RAM_SIZE), (PERIPHERALS, PERIPHERALS_SIZE), (CORE, CORE_SIZE)):
            self._uc.hook_add(data, self._touch, None, start, start + size - 1)
        self._uc.ctl_flush_tb()  # code translated before knows of no hooks

    def _touch(self, *_):
        self.accesses += self._stepping

    def _before(self, uc, address, size, _):
        """Lets one instruction pass, and an IT block whole."""
        if self._in_handler or not self._stepping:
            return
        if self._at is not None and not self._block:
            uc.emu_stop()
            return
        self._block = max(0, self._block - 1)
        self._at = address
        code = self._image[address - FLASH : address - FLASH + 2]
        if code[1] == 0xBF and code[0] & 15:
            self._block, self._long = 5 - (code[0] & -code[0]).bit_length(), True

    def boundaries(self, data):
        """Stands before each instruction that `data` causes."""
        self._receive += data
        while True:
            irq = self._pending()
            if irq is not None and self._interruptible():
                self._interrupt(irq)
            elif self._asleep:
                return
            else:
                yield
                self._step()

    def _step(self):
        self._stepping, self._at, self._block, self._long = True, None, 0, False
        before = self.accesses
        self._emulate(self._pc, 0xFFFF_FFFE)
        self._stepping = False
        assert not self._long or self.accesses <= before + 1  # else a boundary would be left out
        pc = self._uc.reg_read(arm.UC_ARM_REG_PC)
        self._asleep = self._at == pc - 2 and self._uc.mem_read(pc - 2, 2) == WFI
        self._pc = pc | 1

    @property
    def masked(self):
        """Whether interrupts wait: then one that comes is taken at a later boundary."""
        masks = (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI)
        return any(self._uc.reg_read(mask) for mask in masks)

    def interrupted(self, other):
        """Pins and answers of a copy that takes the alarm's interrupt here."""
        for register in REGISTERS:
            other._uc.reg_write(register, self._uc.reg_read(register))
        other._uc.mem_write(RAM, bytes(self._uc.mem_read(RAM, RAM_SIZE)))
        other.restore((other._uc.context_save(), *self.save()[1:]))
        other._pended = True
        other.settle()
        return seen(other)


def seen(machine):
    """What the outside sees in the next half millisecond."""
    machine.run_until(machine.now_us + HORIZON_US)
    messages = [frame.message for frame in Decoder().feed(b"\0" + bytes(machine.sent))]
    answers = tuple(
        (type(m).__name__, getattr(m, "result", None), m.state)
        for m in messages
        if isinstance(m, Ack | HelloAck)
    )
    return tuple(machine.outputs), answers


@pytest.fixture(scope="module")
def flashed(limits, need_tool):
    """The image of a board whose valves are quick."""
    try:
        return image(msgspec.structs.replace(limits, **QUICK)).with_suffix(".bin")
    except CompilerError as error:
        need_tool(str(error))


MESSAGES = {
    "plan": lambda s: Cmd(
        s, 2, 0, 900_000, (100, 200, 0, 0, 100, 100, 100, 100), (0, 0, 0, 0, 250, 150, 50, 80)
    ),
    "disarm": lambda _: Disarm(),
    "hello": lambda _: Hello(3),
    "arm": Arm,
    "bearing": lambda s: Bearing(s, 1),
}


def armed(machine):
    """Four valves open, to be closed or continued by what comes next; the session."""
    decoder = Decoder()

    def answer(message, seq):
        machine.feed(encode_message(message, seq, 0))
        *_, newest = (frame.message for frame in decoder.feed(bytes(machine.sent)))
        machine.sent.clear()
        return newest

    session = answer(Hello(1), 1).session
    answer(Arm(session), 2)
    answer(Cmd(session, 1, 0, 900_000, (300_000,) * 4 + (0,) * 4, (0,) * 8), 3)
    machine.run_until(machine.now_us + 20_000)
    machine.sent.clear()
    machine.outputs.clear()
    return session


def everywhere(path, kind):
    """What was seen, each with how many boundaries; and how many there were."""
    stepped, copy = Stepped(path), Machine(path, adc=SUPPLIED)
    data = encode_message(MESSAGES[kind](armed(stepped)), 50, 0)
    found, boundaries, counted, was_masked = Counter(), 0, -1, False
    for _ in stepped.boundaries(data):
        boundaries += 1
        if not stepped.masked and (stepped.accesses != counted or was_masked):
            counted = stepped.accesses
            found[stepped.interrupted(copy)] += 1
        was_masked = stepped.masked
    return seen(stepped), found, boundaries


@pytest.mark.slow
@pytest.mark.parametrize("kind", MESSAGES)
def test_wherever_the_interrupt_comes_the_outside_sees_the_same(flashed, kind):
    undisturbed, found, boundaries = everywhere(flashed, kind)
    assert boundaries > {"plan": 9_000}.get(kind, 1_000)
    assert list(found) == [undisturbed]
    assert len(undisturbed[0]) == {"plan": 9, "arm": 0}.get(kind, 1)  # changes of the pins


@pytest.mark.slow
def test_without_the_critical_sections_plans_are_torn_and_this_test_sees_it(flashed, tmp_path):
    code = flashed.read_bytes()
    msr_basepri, nop = re.compile(rb"[\x80-\x8f]\xf3\x11\x88"), b"\xaf\xf3\x00\x80"
    assert len(msr_basepri.findall(code)) >= 2
    bare = tmp_path / "bare.bin"
    bare.write_bytes(msr_basepri.sub(nop, code))
    undisturbed, found, _ = everywhere(bare, "plan")
    assert undisturbed == everywhere(flashed, "plan")[0]
    assert len(found) > 5
