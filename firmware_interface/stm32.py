"""An STM32F405 in this process: the unmodified image on Unicorn's Cortex-M4, in virtual time.

Instructions take no time; time passes only while the program sleeps (WFI). So runs are exact and
reproducible: alarms occur at their microsecond, and stores to GPIO are recorded with their time.

Modelled as in ST's RM0090, as far as the image uses it: clocks and reset flags (RCC), GPIOC, TIM2,
USART1, ADC1's injected channels, the independent watchdog, the random generator; the interrupts of
TIM2 and USART1 by priority, without nesting. Accesses to anything else are in `unknown`. Not
modelled: cycles, baud rate, floating point.

Unicorn lacks M-profile interrupts: the handler is called with a return address that ends the
emulation, and the registers that the core would stack are kept here.
"""

import copy
from pathlib import Path
from typing import Any, NamedTuple

import unicorn
from unicorn import arm_const as arm

from firmware_interface.messages import ResetCause
from testbed.core.error import TestbedError

FLASH, FLASH_SIZE = 0x0800_0000, 0x10_0000
RAM, RAM_SIZE = 0x2000_0000, 0x2_0000
PERIPHERALS, PERIPHERALS_SIZE = 0x4000_0000, 0x3_0000
RANDOM, RANDOM_SIZE, CORE, CORE_SIZE = 0x5006_0000, 0x1000, 0xE000_E000, 0x1000
LANDING = 0x0010_0000  # where handlers return to

RCC_CR, RCC_CFGR, RCC_CSR = 0x4002_3800, 0x4002_3808, 0x4002_3874
GPIOC_MODER, GPIOC_BSRR = 0x4002_0800, 0x4002_0818
IWDG_KR, IWDG_PR, IWDG_RLR = 0x4000_3000, 0x4000_3004, 0x4000_3008
TIM2_CR1, TIM2_DIER, TIM2_SR = 0x4000_0000, 0x4000_000C, 0x4000_0010
TIM2_EGR, TIM2_CNT, TIM2_CCR1 = 0x4000_0014, 0x4000_0024, 0x4000_0034
USART1_SR, USART1_DR, USART1_CR1 = 0x4001_1000, 0x4001_1004, 0x4001_100C
ADC1_JDR1, ADC1_JDR2, RNG_SR, RNG_DR = 0x4001_203C, 0x4001_2040, 0x5006_0804, 0x5006_0808
NVIC_ISER0, NVIC_ISER1, NVIC_ISPR0, NVIC_IPR = 0xE000_E100, 0xE000_E104, 0xE000_E200, 0xE000_E400
PLAIN = frozenset({  # registers stored and read back, without effect here
    RCC_CR, RCC_CFGR, 0x4002_3804, 0x4002_3830, 0x4002_3834, 0x4002_3840, 0x4002_3844,
    0x4002_3C00,  # FLASH_ACR
    0x4002_0000, 0x4002_000C, 0x4002_0024,  # GPIOA
    TIM2_CR1, TIM2_DIER, TIM2_CCR1, 0x4000_0028, 0x4000_002C, 0x4001_1008, USART1_CR1,
    0x4001_2004, 0x4001_2008, 0x4001_2010, 0x4001_2034, 0x4001_2038, 0x4001_2304,
    0x5006_0800, NVIC_ISER0, NVIC_ISER1, 0xE000_E41C, 0xE000_E425, IWDG_PR, IWDG_RLR,
})  # fmt: skip

TIM2, USART1 = 28, 37  # numbers of interrupts
RXNE, TXE, TC, CC1, LSI_HZ = 1 << 5, 1 << 7, 1 << 6, 1 << 1, 32_000
CAUSES = {  # flags in RCC_CSR; power-on sets all of a reset's, RM0090 7.3.21
    ResetCause.UNKNOWN: 0,
    ResetCause.POWER_ON: 0x0E00_0000,
    ResetCause.BROWN_OUT: 0x0600_0000,
    ResetCause.PIN: 0x0400_0000,
    ResetCause.SOFTWARE: 0x1400_0000,
    ResetCause.WATCHDOG: 0x2400_0000,
}
BUDGET = 10_000_000  # limit of instructions without sleep; a boot, the longest, takes 30 000
NEVER, WRAP = 1 << 62, 1 << 32
WFI, CPSIE_I, ISB = b"\x30\xbf", b"\x62\xb6", b"\xbf\xf3\x6f\x8f"


class Store(NamedTuple):
    """A write of the program to a GPIO register of the valves."""

    t_us: int
    register: int
    value: int


class MachineError(TestbedError):
    """The image uses something that is not modelled, or does not sleep again."""


class Machine:
    """The chip with an image in its flash.

    Args:
        image: the .bin file for flashing.
        cause: of the first boot.
        random: first value of the random generator, which counts up.
        clock_us: initial count of TIM2, for tests near its wrap.
        adc: supply and pressure [counts].
    """

    def __init__(
        self,
        image: Path,
        cause: ResetCause = ResetCause.POWER_ON,
        random: int = 1,
        clock_us: int = 0,
        adc: tuple[int, int] = (0, 0),
    ) -> None:
        self.now_us = 0  # since power-on
        self.adc = adc
        self.sent = bytearray()
        self.outputs: list[tuple[int, int]] = []  # changes of the pins of port C (time, pins)
        self.stores: list[Store] = []  # of the first millisecond after a reset
        self.unknown: set[int] = set()
        self.feeds = 0  # of the independent watchdog
        self.resets: list[ResetCause] = []
        self.mute_alarm = False  # fault injection: TIM2's interrupt never comes
        self._random, self._clock_us = random, clock_us
        self._in_handler = self._stopped = False
        self._countdown = self._block = 0  # see feed_preempted
        self._stopped_at = -1
        self._image = image.read_bytes()
        self.pins = 0  # of port C, by the outside
        self._uc = self._chip()
        self._main_program = self._uc.context_save()  # while an interrupt runs
        self.reset(cause)
        fixed = ("_uc", "_image", "_main_program")
        self._moving = tuple(k for k in self.__dict__ if k not in fixed)

    def _chip(self) -> unicorn.Uc:
        uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        for start, size in ((FLASH, FLASH_SIZE), (RAM, RAM_SIZE)):
            uc.mem_map(start, size)
        uc.mem_map(LANDING, 0x1000)
        uc.mem_write(FLASH, self._image)
        for start, size in (
            (PERIPHERALS, PERIPHERALS_SIZE), (RANDOM, RANDOM_SIZE), (CORE, CORE_SIZE),
        ):  # fmt: skip
            uc.mmio_map(start, size, self._load, start, self._store, start)
        at = -1
        while (at := self._image.find(ISB, at + 1)) >= 0:
            behind = FLASH + at + len(ISB)
            uc.hook_add(unicorn.UC_HOOK_CODE, self._behind_barrier, None, behind, behind)
        return uc

    def _behind_barrier(self, uc: unicorn.Uc, address: int, size: int, _: None) -> None:
        """Stop at a barrier, where pending interrupts are taken at the latest."""
        if self._pending() is not None:
            self._stopped = True
            uc.emu_stop()

    # Reset

    def reset(self, cause: ResetCause) -> None:
        """Reset the registers, keep the RAM, and run the program to its first sleep."""
        self._reg: dict[int, int] = {}
        self._csr = CAUSES[cause]
        self._driven = self._odr = 0
        self._compared = self._pended = self._unlocked = False
        self._counting_from = NEVER  # time at which TIM2 was 0
        self._alarm_at = self._bite_at = NEVER
        self._receive = bytearray()
        self._reset_at = self.now_us
        self._update_pins()
        self.resets.append(cause)
        uc = self._uc
        uc.reg_write(arm.UC_ARM_REG_PRIMASK, 0)
        uc.reg_write(arm.UC_ARM_REG_BASEPRI, 0)
        uc.reg_write(arm.UC_ARM_REG_SP, self._vector(-16))
        self._pc = self._vector(-15)
        self._asleep = False
        self.settle()

    def save(self) -> tuple[Any, ...]:
        """The complete state, for `restore`."""
        context, ram = self._uc.context_save(), bytes(self._uc.mem_read(RAM, RAM_SIZE))
        return context, ram, copy.deepcopy({k: self.__dict__[k] for k in self._moving})

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Restore a state of `save`."""
        context, ram, moving = saved
        self._uc.context_restore(context)
        self._uc.mem_write(RAM, ram)
        self.__dict__.update(copy.deepcopy(moving))

    # Time

    def run_until(self, t_us: int) -> None:
        """Run up to and including `t_us`."""
        while (event := min(self._alarm_at, self._bite_at)) <= t_us:
            self.now_us = event
            if event == self._bite_at:
                self.reset(ResetCause.WATCHDOG)
                continue
            self._compared = True
            self._set_alarm()
            self.settle()
        self.now_us = t_us

    def _count(self) -> int:
        if self._counting_from == NEVER:
            return 0
        return (self._clock_us + self.now_us - self._counting_from) % WRAP

    def _set_alarm(self) -> None:
        """Set the next time at which the counter reaches the compare register."""
        if self._counting_from != NEVER:
            ahead = (self._reg.get(TIM2_CCR1, 0) - self._count()) % WRAP
            self._alarm_at = self.now_us + (ahead or WRAP)

    # The program

    def feed(self, data: bytes) -> None:
        """Receive bytes on the serial line now."""
        self._receive += data
        self.settle()

    def feed_preempted(self, data: bytes, after: int) -> bool:
        """Like `feed`, but TIM2's interrupt becomes pending while the bytes are processed.

        Args:
            data: received bytes.
            after: number of main program instructions before it, without those of interrupts.

        Returns:
            whether the program executed that many; if not, no interrupt was added.
        """
        self._receive += data
        self._countdown, self._block = after, 0
        hook = self._uc.hook_add(unicorn.UC_HOOK_CODE, self._count_down, None, FLASH, RAM)
        self._uc.ctl_flush_tb()  # type: ignore[attr-defined] # translated code would not call it
        try:
            self.settle()
        finally:
            self._uc.hook_del(hook)
            self._uc.ctl_flush_tb()  # type: ignore[attr-defined]
        return self._countdown < 0

    def _count_down(self, uc: unicorn.Uc, address: int, size: int, _: None) -> None:
        """Hook before every instruction, which counts down to the added interrupt."""
        if self._in_handler or address == self._stopped_at:
            self._stopped_at = -1  # the instruction after a stop is reported twice
            return
        in_block, self._block = self._block > 0, max(0, self._block - 1)
        code = self._code(address)
        if code[1] == 0xBF and code[0] & 15:  # IT: the next one to four belong together
            self._block = 4 - ((code[0] & -code[0]) & 15).bit_length() + 1
        self._countdown -= 1
        if self._countdown == -1:
            self._pended = True
        masked = uc.reg_read(arm.UC_ARM_REG_PRIMASK) or uc.reg_read(arm.UC_ARM_REG_BASEPRI)
        if self._countdown < 0 and self._pended and not masked and not in_block:
            self._stopped_at = address
            self._stopped = True
            uc.emu_stop()

    def settle(self) -> None:
        """Run interrupts and main program until it sleeps and nothing is pending."""
        while True:
            irq = self._pending()
            if irq is not None and self._interruptible():
                self._interrupt(irq)
            elif self._asleep:  # nothing pending, or interrupts disabled permanently
                return
            else:
                self._main()

    def _pending(self) -> int | None:
        reg = self._reg
        alarm = self._pended or (self._compared and reg.get(TIM2_DIER, 0) & CC1)
        alarm = alarm and reg.get(NVIC_ISER0, 0) >> TIM2 & 1 and not self.mute_alarm
        wanted = reg.get(USART1_CR1, 0) & self._line_flags() & (TXE | RXNE)
        line = wanted and reg.get(NVIC_ISER1, 0) >> 5 & 1
        found = [n for n, waits in ((TIM2, alarm), (USART1, line)) if waits]
        base = self._uc.reg_read(arm.UC_ARM_REG_BASEPRI) if found else 0
        found = [n for n in found if not 0 < base <= self.priority(n)]
        return min(found, key=self.priority, default=None)

    def priority(self, number: int) -> int:
        """Priority of an interrupt; lower numbers come first."""
        return self._reg.get(NVIC_IPR + number, 0)

    def _line_flags(self) -> int:
        return TXE | TC | (RXNE if self._receive else 0)

    def _interruptible(self) -> bool:
        """Whether an interrupt is taken here; a sleeping program wakes and runs until it is."""
        if self._asleep and self._code(self._pc) == CPSIE_I:
            self._uc.reg_write(arm.UC_ARM_REG_PRIMASK, 0)
            self._pc += 2
            self._asleep = False
            return True
        return not self._uc.reg_read(arm.UC_ARM_REG_PRIMASK)

    def _interrupt(self, number: int) -> None:
        uc = self._uc
        if number == TIM2:
            self._pended = False
        self._asleep, self._in_handler = False, True
        uc.context_update(self._main_program)
        uc.reg_write(arm.UC_ARM_REG_LR, LANDING | 1)
        self._emulate(self._vector(number), LANDING)
        if uc.reg_read(arm.UC_ARM_REG_PC) & ~1 != LANDING:
            raise self._endless()
        uc.context_restore(self._main_program)
        self._in_handler = False

    def _main(self) -> None:
        self._asleep = False
        self._emulate(self._pc, 0xFFFF_FFFE)
        self._pc = self._uc.reg_read(arm.UC_ARM_REG_PC) | 1
        self._asleep = self._code(self._pc - 2) == WFI
        if not (self._asleep or self._stopped):
            raise self._endless()

    def _endless(self) -> MachineError:
        at = f"{self.now_us} us without sleep, now at {self._uc.reg_read(arm.UC_ARM_REG_PC):#x}"
        which = "the image does not leave a loop (arm-none-eabi-addr2line shows which)"
        return MachineError(f"{BUDGET} instructions at {at}: {which}")

    def _code(self, address: int) -> bytes:
        """The halfword of the program at `address`."""
        at = (address & ~1) - FLASH
        return self._image[at : at + 2]

    def _vector(self, number: int) -> int:
        return int.from_bytes(self._image[4 * (16 + number) :][:4], "little")

    def _emulate(self, start: int, end: int) -> None:
        self._stopped = False
        try:
            self._uc.emu_start(start | 1, end, count=BUDGET)
        except unicorn.UcError as error:
            raise MachineError(f"{error} at {self._uc.reg_read(arm.UC_ARM_REG_PC):#x}") from error

    # Registers

    def _load(self, uc: unicorn.Uc, offset: int, size: int, start: int) -> int:
        at = start + offset
        if at == TIM2_CNT:
            return self._count()
        if at == USART1_SR:
            return self._line_flags()
        if at == USART1_DR:
            return self._receive.pop(0) if self._receive else 0
        if at in (ADC1_JDR1, ADC1_JDR2):
            return self.adc[at == ADC1_JDR2]
        value = self._reg.get(at, 0)
        if at == RCC_CR:  # oscillators are ready at once
            return value | (value & 0x0101_0000) << 1
        if at == RCC_CFGR:
            return value | (value & 3) << 2
        if at == RCC_CSR:
            return self._csr
        if at == RNG_SR:
            return 1
        if at == RNG_DR:
            self._random += 1
            return self._random - 1
        if at not in PLAIN:
            self.unknown.add(at)
        return value

    def _store(self, uc: unicorn.Uc, offset: int, size: int, value: int, start: int) -> None:
        at = start + offset
        if at == GPIOC_BSRR:
            self._odr = (self._odr & ~(value >> 16) | value) & 0xFFFF
            self._note(at, value)
        elif at == TIM2_SR:
            self._compared = self._compared and bool(value & CC1)
        elif at == TIM2_CCR1:
            self._reg[at] = value
            self._set_alarm()
        elif at == USART1_DR:
            self.sent.append(value & 0xFF)
        elif at == IWDG_KR:
            self._feed_watchdog(value)
        elif at == NVIC_ISPR0:
            self._pended = self._pended or bool(value >> TIM2 & 1)
        elif at == TIM2_EGR:
            if value & 1:
                self._counting_from = self.now_us
                self._set_alarm()
            self._compared = self._compared or bool(value & CC1)
        elif at == GPIOC_MODER:
            self._driven = sum(1 << i for i in range(16) if value >> 2 * i & 3 == 1)
            self._note(at, value)
        elif at == RCC_CSR:
            self._csr = 0 if value >> 24 & 1 else self._csr
        elif self._unlocked or at not in (IWDG_PR, IWDG_RLR):
            if at not in PLAIN:
                self.unknown.add(at)
            self._reg[at] = value

    def _note(self, register: int, value: int) -> None:
        if self.now_us < self._reset_at + 1000:
            self.stores.append(Store(self.now_us, register, value))
        self._update_pins()

    def _update_pins(self) -> None:
        """Compute the pins: high if an output drives them, otherwise low by the pull-down."""
        if (pins := self._odr & self._driven) != self.pins:
            self.pins = pins
            self.outputs.append((self.now_us, pins))

    def _feed_watchdog(self, key: int) -> None:
        self._unlocked = key == 0x5555
        if key == 0xCCCC:
            self._bite_at = self.now_us
        self.feeds += key == 0xAAAA
        if key in (0xCCCC, 0xAAAA) and self._bite_at != NEVER:
            per_count = 4 << self._reg.get(IWDG_PR, 0)
            counts = self._reg.get(IWDG_RLR, 0xFFF) + 1
            self._bite_at = self.now_us + counts * per_count * 1_000_000 // LSI_HZ
