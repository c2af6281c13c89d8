"""What is wrong with an image beyond the registers after boot: the order of its stores, the line at
its limits, the alarm that comes too late, rare reset causes.

The rules are from ST, RM0090; sections are named where they are checked.
"""

import unicorn
from unicorn import arm_const as arm

from firmware_interface.frame import Decoder, encode_message
from firmware_interface.messages import Ack, Hello, HelloAck, Ping, ResetCause
from firmware_interface.messages import Status as Report
from firmware_interface.stm32 import (
    FLASH,
    GPIOC_BSRR,
    IWDG_KR,
    RAM,
    RCC_CFGR,
    RCC_CR,
    RCC_CSR,
    RNG_SR,
    RXNE,
    TIM2_CCR1,
    TIM2_CNT,
    TIM2_CR1,
    TIM2_DIER,
    TIM2_EGR,
    TIM2_SR,
    TXE,
    USART1_CR1,
    USART1_SR,
    WRAP,
    Machine,
)

GATES = {  # 1 KiB block of registers: (enable register, bit), RM0090 7.3.10 to 7.3.14
    0x4002_0000: (0x4002_3830, 0),  # GPIOA, AHB1ENR
    0x4002_0800: (0x4002_3830, 2),  # GPIOC
    0x5006_0800: (0x4002_3834, 6),  # RNG, AHB2ENR
    0x4000_0000: (0x4002_3840, 0),  # TIM2, APB1ENR
    0x4001_1000: (0x4002_3844, 4),  # USART1, APB2ENR
    0x4001_2000: (0x4002_3844, 8),  # ADC1
}
PLLCFGR, FLASH_ACR, TIM2_PSC, USART1_BRR = 0x4002_3804, 0x4002_3C00, 0x4000_0028, 0x4001_1008
NVIC_ISER, NVIC_IPR, ADC1_CR2 = (0xE000_E100, 0xE000_E104), 0xE000_E400, 0x4001_2008
ADC_SET_UP = {0x4001_2004, 0x4001_2010, 0x4001_2034, 0x4001_2038, 0x4001_2304}
PLLON, PLLRDY, ORE, RMVF = 1 << 24, 1 << 25, 1 << 3, 1 << 24
NINE = 0x1FF  # PC0 to PC8
RING = 1024  # bytes that the board keeps while its main loop is busy
RARE = {  # flags of RCC_CSR, RM0090 7.3.21, one at a time
    1 << 30: ResetCause.WATCHDOG,  # WWDGRSTF
    1 << 29: ResetCause.WATCHDOG,  # IWDGRSTF
    1 << 28: ResetCause.SOFTWARE,
    1 << 27: ResetCause.POWER_ON,
    1 << 25: ResetCause.BROWN_OUT,
    1 << 26: ResetCause.PIN,
    1 << 31 | 1 << 24: ResetCause.UNKNOWN,  # LPWRRSTF, which the board does not use
}


class Watched(Machine):
    """Notes every store, and what no program may do."""

    def __init__(self, path, **options):
        self.written = []
        self.broken = ""
        super().__init__(path, **options)

    def _gate(self, at):
        gate = GATES.get(at & ~0x3FF)
        if gate and not self._reg.get(gate[0], 0) >> gate[1] & 1:
            self.broken = f"register {at:#x} of a peripheral without clock"

    def _load(self, uc, offset, size, start):
        self._gate(start + offset)
        return super()._load(uc, offset, size, start)

    def _store(self, uc, offset, size, value, start):
        at = start + offset
        self._gate(at)
        reg = self._reg
        if at == PLLCFGR and reg.get(RCC_CR, 0) & PLLON:
            self.broken = "PLLCFGR while the PLL runs (7.3.2)"
        if at == RCC_CFGR and value & 3 == 2 and reg.get(FLASH_ACR, 0) & 7 < 5:
            self.broken = "168 MHz before the wait states (3.5.1)"
        if at == RCC_CFGR and value & 3 == 2 and reg.get(at, 0) & 0xFC00 != 5 << 10 | 4 << 13:
            self.broken = "168 MHz before the dividers of the buses (7.2)"
        if at == GPIOC_BSRR and (value & value >> 16 or (value | value >> 16) & ~NINE & 0xFFFF):
            self.broken = "BSRR sets and resets a pin, or one that is not the board's (8.4.7)"
        if at == TIM2_SR and (value & 2 or (value and value | 2 != WRAP - 1)):
            self.broken = "TIM2_SR: flags are cleared by 0, others need 1 (18.4.5)"
        if at == IWDG_KR and value not in (0xAAAA, 0x5555, 0xCCCC):
            self.broken = "an unknown key for the watchdog (21.4.1)"
        if at == TIM2_EGR and value & 1 and not reg.get(TIM2_CR1, 0) & 4:
            self.broken = "UG without URS sets the update flag (18.4.1)"
        if at == USART1_CR1 and value & 1 << 13 and USART1_BRR not in reg:
            self.broken = "USART1 on before its rate (30.3.2)"
        if at == RCC_CSR and not value & RMVF:
            self.broken = "RCC_CSR written without clearing the flags (7.3.21)"
        self.written.append((at, value))
        super()._store(uc, offset, size, value, start)


def first(written, register, bits=0):
    """When a register was first written with these bits."""
    found = (k for k, (at, value) in enumerate(written) if at == register and value & bits == bits)
    return next(found, len(written))


def order_of(path):
    """Stores whose order or count the manual gives."""
    machine = Watched(path)
    written = machine.written
    pairs = (
        (first(written, TIM2_PSC), first(written, TIM2_EGR, 1), "UG before the prescaler (18.4.6)"),
        (first(written, TIM2_SR), first(written, TIM2_DIER), "TIM2's interrupt with old flags"),
        (first(written, TIM2_EGR, 1), first(written, TIM2_CR1, 1), "TIM2 starts unprepared"),
        (first(written, NVIC_IPR + 28), first(written, NVIC_ISER[0]), "TIM2 without priority"),
        (first(written, NVIC_IPR + 37), first(written, NVIC_ISER[1]), "USART1 without priority"),
        (first(written, ADC1_CR2, 1), first(written, ADC1_CR2, 1 << 30), "SWSTART before ADON"),
        *(
            (first(written, at), first(written, ADC1_CR2, 1), "ADC1 unprepared")
            for at in ADC_SET_UP
        ),
        # until then it counts from 4095: 512 ms
        (first(written, IWDG_KR, 0xAAAA), first(written, RCC_CR), "the watchdog unfed (21.3.1)"),
        (first(written, 0x4002_000C), first(written, USART1_CR1), "the line before its pull-up"),
        (
            first(written, 0x4002_0024),
            first(written, 0x4002_0000, 2 << 18),
            "pins without function",
        ),
    )
    for sooner, later, what in pairs:
        if sooner >= later or later == len(written):
            return what
    keys = [value for at, value in written if at == IWDG_KR]
    if keys[:3] != [0xCCCC, 0x5555, 0xAAAA]:  # start, unlock, reload: 21.3.1 and 21.3.2
        return "the watchdog's keys"
    machine.feed(encode_message(Hello(7), 1, 0))
    machine.run_until(250_000)
    return machine.broken


class Overrun(Machine):
    """Only the overrun flag is seen; it raises the same interrupt (RM0090 30.4)."""

    def _load(self, uc, offset, size, start):
        value = super()._load(uc, offset, size, start)
        if start + offset == USART1_SR and value & RXNE:
            return value & ~RXNE | ORE
        return value


class Slow(Machine):
    """The transmit register is free at every fourth look."""

    looks = 0

    def _load(self, uc, offset, size, start):
        value = super()._load(uc, offset, size, start)
        if start + offset == USART1_SR:
            self.looks += 1
            return value & ~TXE if self.looks % 4 else value
        return value


def acks(machine, data):
    machine.sent.clear()
    machine.feed(data)
    return [f.message for f in Decoder().feed(bytes(machine.sent)) if f.type == Ack.CODE]


def line_of(path):
    """The ring to its last byte, stamps, an overrun, a slow line."""
    ping = encode_message(Ping(), 9, 5)
    for kind in (Machine, Overrun):
        machine = kind(path)
        machine.run_until(1234)
        found = acks(machine, ping)
        if [ack.t2_us for ack in found] != [1234]:
            return f"the stamp of a byte ({kind.__name__})"
    machine = Machine(path)
    for shift in (0, 1, 333):  # the ring's end is anywhere
        acks(machine, bytes(shift))
        if len(acks(machine, bytes(RING - len(ping)) + ping)) != 1:
            return "the ring holds less than it should"
        if acks(machine, bytes(RING - len(ping) + 1) + ping):
            return "the ring holds more than it should"
        acks(machine, b"\0")
    machine = Slow(path)
    machine.run_until(1_000_000)
    decoder = Decoder()
    seqs = [frame.seq for frame in decoder.feed(bytes(machine.sent))]
    if decoder.bad or seqs != list(range(len(seqs))) or len(seqs) < 20:
        return "frames on a slow line"
    if machine._reg[USART1_CR1] & TXE:
        return "the transmit interrupt stays on"
    return ""


class Passed(Machine):
    """When the alarm has been set the counter is read as this far behind it, once."""

    behind = None
    armed = forced = False

    def _load(self, uc, offset, size, start):
        if start + offset == TIM2_CNT and self.armed:
            self.armed = False
            return (self._reg[TIM2_CCR1] + self.behind) % WRAP
        return super()._load(uc, offset, size, start)

    def _store(self, uc, offset, size, value, start):
        super()._store(uc, offset, size, value, start)
        if start + offset == TIM2_CCR1 and self.behind is not None:
            self.armed = True
        if start + offset == TIM2_EGR and value == 2 and self.behind is not None:
            self.forced, self.behind = True, None


def alarm_of(path):
    """An alarm that the counter has passed comes by software (CC1G), another does not."""
    for behind, wanted in ((0, 1), (1, 1), (2**31 - 1, 1), (-1, 0), (2**31, 0)):
        machine = Passed(path)
        machine.behind = behind
        machine.run_until(3_000)
        if machine.forced != bool(wanted):
            return f"an alarm {behind} us ago"
    machine = Machine(path)
    seen = set()

    def look(uc, address, size, _):
        masks = arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_PRIMASK
        seen.add(tuple(uc.reg_read(mask) for mask in masks))

    machine._uc.hook_add(unicorn.UC_HOOK_CODE, look, None, FLASH, RAM)
    machine._uc.ctl_flush_tb()
    acks(machine, encode_message(Ping(), 9, 5))
    if seen != {(0, 0), (0x80, 0), (0, 1)}:
        return f"masks of interrupts (BASEPRI, PRIMASK): {seen}"
    return ""


class Silent(Machine):
    """The random generator is never ready."""

    def _load(self, uc, offset, size, start):
        return 0 if start + offset == RNG_SR else super()._load(uc, offset, size, start)


def boots_of(path):
    """Rare reset causes, nonces without random numbers, sensors at their ends, vectors."""
    for flags, cause in RARE.items():
        kind = type("Flagged", (Machine,), {"_flags": flags})
        kind._load = lambda s, uc, o, n, b: (
            s._flags if b + o == RCC_CSR else Machine._load(s, uc, o, n, b)
        )
        machine = kind(path)
        machine.feed(encode_message(Hello(1), 1, 0))
        hello = next(
            f.message for f in Decoder().feed(bytes(machine.sent)) if f.type == HelloAck.CODE
        )
        if hello.reset_cause != cause:
            return f"reset cause of the flags {flags:#x}"
    machine, nonces = Silent(path), set()
    for _ in range(4):
        machine.reset(ResetCause.PIN)
        machine.sent.clear()
        machine.feed(encode_message(Hello(1), 1, 0))
        said = Decoder().feed(bytes(machine.sent))
        nonces |= {f.message.boot_nonce for f in said if f.type == HelloAck.CODE}
    if len(nonces) != 4:
        return "nonces repeat without the random generator"
    for counts in ((0, 0), (1, 1), (4095, 4095), (2048, 1023)):
        machine = Machine(path, adc=counts)
        machine.run_until(200_000)
        said = [f.message for f in Decoder().feed(bytes(machine.sent)) if f.type == Report.CODE]
        supply, pressure = counts
        if (said[-1].supply_mv, said[-1].supply_pa) != (
            supply * 33_000 // 4095,
            pressure * 1_000_000 // 4095,
        ):
            return f"sensors at {counts}"
    table = Machine(path)
    faults = {table._vector(number - 16) for number in (2, 3, 4, 5, 6, 11, 12, 14, 15)}
    if len(faults) != 1 or any(table._vector(number - 16) for number in (7, 8, 9, 10, 13)):
        return "the vectors of the exceptions (PM0214 2.3.4)"
    return ""


def wrong_beyond(path):
    """The first thing that is wrong; empty: nothing."""
    return order_of(path) or line_of(path) or alarm_of(path) or boots_of(path)
