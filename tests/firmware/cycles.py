"""The emulated chip with a clock: instructions take time, and interrupts nest by their priority.

Costs are upper estimates for a Cortex-M4 (ARM, "Cortex-M4 Technical Reference Manual", 3.3): 1
cycle per instruction, 1 more for each word of memory and 4 for each register of a peripheral, 12
for a division, and 3 for a jump, whose target comes from flash with its wait states as if nothing
were cached. An interrupt costs 12 cycles to enter and 12 to leave.

Bytes come in and go out at the rate of the line. A byte that is not read before the next one is
complete is lost, as in the chip, which has one register for it.
"""

from collections import deque

import unicorn
from unicorn import arm_const as arm

from firmware_interface.stm32 import (
    FLASH,
    FLASH_SIZE,
    LANDING,
    NEVER,
    RCC_CFGR,
    RXNE,
    TC,
    TIM2,
    TXE,
    USART1,
    USART1_CR1,
    USART1_DR,
    WFI,
    Machine,
    MachineError,
)

BAUD = 460_800
BYTE_US = 10 / BAUD * 1e6  # with start and stop bit
ENTRY = EXIT = 12  # cycles
JUMP, DIVISION, REGISTER = 3, 12, 4
FAST_MHZ, SLOW_MHZ, WAITS = (
    168,
    16,
    5,
)  # with the clock multiplier; without; of the flash at 168 MHz
THREAD = 256  # below every priority


def cost(code):
    """Cycles of an instruction that does not jump, from its first two halfwords."""
    first, second = int.from_bytes(code[:2], "little"), int.from_bytes(code[2:], "little")
    words = 0  # of memory
    if first >> 12 == 0b1011 and first >> 9 & 3 == 2:  # push, pop
        words = (first & 0x1FF).bit_count()
    elif first >> 12 == 0b1100:  # several registers
        words = (first & 0xFF).bit_count()
    elif first >> 11 == 0b01001 or first >> 12 in (0b0101, 0b0110, 0b0111, 0b1000, 0b1001):
        words = 1
    elif first >> 9 == 0b1110100:
        words = 2 if first & 0x40 else second.bit_count()
    elif first >> 9 == 0b1111100:
        words = 1
    return 1 + words + (DIVISION if first & 0xFFD0 == 0xFB90 else 0)


class Timed(Machine):
    """The chip with an image in its flash; see `Machine`."""

    multiplies = True  # fault injection: False, the clock multiplier never starts

    def __init__(self, path, **options):
        self._at_us = 0.0  # `now_us`, finer
        self._costs = {}  # by address
        self._last = self._block = 0  # address behind the newest instruction; left of an IT block
        self._active = [THREAD]
        self._line = deque()  # (time, byte) to come
        self._arrived = 0.0  # when the byte in the register was complete
        self._free_at = 0.0  # when the transmitter has sent all
        self.lost = 0  # bytes that came too late to be read
        self.waited_us = 0.0  # longest wait of a byte in the register
        self.longest_us = {TIM2: 0.0, USART1: 0.0}  # without the interrupts inside
        self._inside = 0.0
        super().__init__(path, **options)

    def _chip(self):
        uc = super()._chip()
        uc.hook_add(unicorn.UC_HOOK_CODE, self._tick, None, FLASH, FLASH + FLASH_SIZE)
        return uc

    @property
    def mhz(self):
        """Of the core: after the switch to the clock multiplier, 168."""
        return FAST_MHZ if self._reg.get(RCC_CFGR, 0) & 2 and self.multiplies else SLOW_MHZ

    def _spend(self, cycles):
        self._at_us += cycles / self.mhz
        self.now_us = int(self._at_us)

    def _tick(self, uc, address, size, _):
        """Before every instruction: time passes, and what is due happens."""
        in_block, self._block = self._block > 0, max(0, self._block - 1)
        code = self._code(address)
        if code[1] == 0xBF and code[0] & 15:
            self._block = 4 - ((code[0] & -code[0]) & 15).bit_length() + 1
        if address not in self._costs:
            self._costs[address] = cost(self._image[address - FLASH :][:4])
        cycles = self._costs[address]
        if address != self._last:
            cycles += JUMP + (WAITS if self.mhz == FAST_MHZ else 0)
        self._last = address + size
        self._spend(cycles)
        self._happen()
        if in_block or uc.reg_read(arm.UC_ARM_REG_PRIMASK):
            return
        first = self._pending()
        if first is not None and self.priority(first) < self._active[-1]:
            self._last = address
            self._stopped = True
            uc.emu_stop()

    def _happen(self):
        """Bytes that are complete, and the alarm."""
        while self._line and self._line[0][0] <= self._at_us:
            at, byte = self._line.popleft()
            if self._receive:
                self.lost += 1
            else:
                self._receive.append(byte)
                self._arrived = at
        if self._alarm_at <= self.now_us:
            self._compared = True
            self._set_alarm()
        if self._bite_at <= self.now_us:
            raise MachineError(f"the independent watchdog bites at {self.now_us} us")

    def _line_flags(self):
        empty = self._free_at - self._at_us <= BYTE_US
        return (TXE if empty else 0) | TC | (RXNE if self._receive else 0)

    def _load(self, uc, offset, size, start):
        self._spend(REGISTER)
        if start + offset == USART1_DR and self._receive:
            self.waited_us = max(self.waited_us, self._at_us - self._arrived)
        value = super()._load(uc, offset, size, start)
        if start + offset == 0x4002_3800 and not self.multiplies:
            value &= ~(1 << 25)  # the multiplier's ready flag never comes
        return value

    def _store(self, uc, offset, size, value, start):
        self._spend(REGISTER)
        super()._store(uc, offset, size, value, start)
        if start + offset == USART1_DR:
            self._free_at = max(self._free_at, self._at_us) + BYTE_US

    # Interrupts nest

    def _interrupt(self, number):
        uc, began, outer = self._uc, self._at_us, self._inside
        self._inside, self._asleep = 0.0, False
        kept = uc.context_save()
        if number == TIM2:
            self._pended = False
        self._active.append(self.priority(number))
        self._spend(ENTRY)
        uc.reg_write(arm.UC_ARM_REG_LR, LANDING | 1)
        at = self._vector(number)
        while True:
            self._emulate(at, LANDING)
            at = uc.reg_read(arm.UC_ARM_REG_PC)
            if at & ~1 == LANDING:
                break
            if not self._stopped:
                raise self._endless()
            inner = self._pending()
            if inner is not None and self.priority(inner) < self._active[-1]:
                self._interrupt(inner)
        self._spend(EXIT)
        self._active.pop()
        uc.context_restore(kept)
        took = self._at_us - began
        self.longest_us[number] = max(self.longest_us[number], took - self._inside)
        self._inside = outer + took

    def _main(self):
        self._asleep = False
        self._emulate(self._pc, 0xFFFF_FFFE)
        self._pc = self._uc.reg_read(arm.UC_ARM_REG_PC) | 1
        self._asleep = not self._stopped and self._code(self._pc - 2) == WFI
        if not (self._asleep or self._stopped):
            raise self._endless()

    def settle(self):
        """Run until the program sleeps and nothing is pending."""
        while True:
            first = self._pending()
            if first is not None and self._interruptible():
                self._interrupt(first)
            elif self._asleep:
                return
            else:
                self._main()

    def send(self, data, at_us):
        """Let bytes follow each other on the line, the first complete at `at_us`."""
        self._line.extend((at_us + k * BYTE_US, byte) for k, byte in enumerate(data))

    def run_until(self, t_us):
        """Run up to `t_us`, or a little further, to the next sleep."""
        while True:
            self.settle()
            due = [self._alarm_at, self._line[0][0] if self._line else NEVER]
            if self._reg.get(USART1_CR1, 0) & TXE:
                due.append(self._free_at - BYTE_US)
            if min(due) > t_us:
                break
            self._at_us = max(self._at_us, min(due)) + 0.01
            self.now_us = int(self._at_us)
            self._happen()
        self._at_us = max(self._at_us, t_us)
        self.now_us = int(self._at_us)
