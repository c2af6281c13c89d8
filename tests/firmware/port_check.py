"""What is wrong with an image: its registers and its behaviour on the emulated chip.

The values are from ST, RM0090, and from the wiring in board.h, not from the port's own headers.
"""

from port_inside import wrong_inside
from port_order import wrong_beyond
from unicorn import arm_const as arm

from firmware_interface.frame import Decoder, encode_message
from firmware_interface.messages import Ack, Arm, Bearing, Cmd, Hello, HelloAck, Ping, ResetCause
from firmware_interface.messages import Status as Report
from firmware_interface.stm32 import RAM, RAM_SIZE, RCC_CFGR, RCC_CR, Machine

CLOSE, OUTPUTS = 0x01FF_0000, 0x0001_5555
AFTER_BOOT = {  # register: (value, what it is)
    0x4002_3804: (8 | 336 << 6 | 1 << 22 | 7 << 24, "PLLCFGR: 8 MHz crystal to 168 MHz"),
    0x4002_3808: (2 | 5 << 10 | 4 << 13, "CFGR: PLL, APB1 / 4, APB2 / 2"),
    0x4002_3800: (3 << 16 | 1 << 19 | 1 << 24, "CR: crystal (ready), its security system, PLL"),
    0x4002_3C00: (5 | 7 << 8, "FLASH_ACR: five wait states, caches"),
    0x4002_3830: (1 | 1 << 2, "AHB1ENR: ports A and C"),
    0x4002_3834: (1 << 6, "AHB2ENR: random generator"),
    0x4002_3840: (1, "APB1ENR: TIM2"),
    0x4002_3844: (1 << 4 | 1 << 8, "APB2ENR: USART1, ADC1"),
    0x4002_0000: (3 << 8 | 3 << 10 | 2 << 18 | 2 << 20, "PA4, PA5 analog; PA9, PA10 line"),
    0x4002_000C: (1 << 20, "PA10 pulled up"),
    0x4002_0024: (7 << 4 | 7 << 8, "PA9, PA10: USART1"),
    0x4000_0000: (1 | 1 << 2, "TIM2 counts"),
    0x4000_000C: (1 << 1, "TIM2 compare interrupt"),
    0x4000_0028: (83, "TIM2 prescaler: 1 us at 84 MHz"),
    0x4000_002C: (0xFFFF_FFFF, "TIM2 wraps at 2^32"),
    0x4001_1008: (182, "USART1: 84 MHz / 182 = 461 538 Bd"),
    0x4001_100C: (1 << 13 | 1 << 3 | 1 << 2 | 1 << 5, "USART1: both ways, receive interrupt"),
    0xE000_E100: (1 << 28, "TIM2 interrupt on"),
    0xE000_E104: (1 << 5, "USART1 interrupt on"),
    0xE000_E41C: (0x80, "the alarm's priority"),
    0xE000_E425: (0x40, "the line's priority, above the alarm's"),
    0x4000_3004: (0, "watchdog / 4"),
    0x4000_3008: (400, "watchdog 50 ms"),
    0x4001_2004: (1 << 8 | 1 << 10, "ADC1: both channels, again and again"),
    0x4001_2008: (1 | 1 << 1 | 1 << 30, "ADC1 on"),
    0x4001_2010: (4 << 12 | 4 << 15, "84 cycles for PA4 and PA5"),
    0x4001_2034: (4, "regular channel 4"),
    0x4001_2038: (1 << 20 | 4 << 10 | 5 << 15, "injected channels 4 and 5"),
    0x4001_2304: (1 << 16, "ADC clock / 4"),
    0x5006_0800: (1 << 2, "random generator on"),
}
ANYTHING = bytes(k * k % 251 for k in range(RAM_SIZE))
SUPPLIED = (3000, 2000)  # counts of the converter
# bits of oscillators that do not start: divider, prescaler, reads of the register: 16 000 looks at
# each of these, one at an oscillator that starts, and two before stores
LOST_CLOCKS = {0x0101_0000: (35, 15, 32_002), 0x0001_0000: (182, 83, 16_003)}


class Cold(Machine):
    """Its RAM holds anything when the power comes, as on the chip."""

    def _chip(self):
        uc = super()._chip()
        uc.mem_write(RAM, ANYTHING)
        return uc


class Deaf(Cold):
    """Oscillators that do not start."""

    never = 0
    looks = 0  # at the oscillators
    switches = True  # to the clock multiplier

    def _load(self, uc, offset, size, start):
        value = super()._load(uc, offset, size, start)
        self.looks += start + offset == RCC_CR
        if start + offset == RCC_CFGR and not self.switches:
            return value & ~0xC
        return value & ~(self.never << 1) if start + offset == RCC_CR else value


def said(machine, decoder):
    found = [frame.message for frame in decoder.feed(bytes(machine.sent))]
    machine.sent.clear()
    return found


def ask(machine, decoder, message, seq, kind=Ack):
    machine.feed(encode_message(message, seq, 0))
    return next((m for m in said(machine, decoder) if isinstance(m, kind)), None)


def wrong_with(path):
    """The first thing that is wrong; empty: nothing."""
    machine, decoder = Cold(path, adc=SUPPLIED), Decoder()
    first, second = (tuple(store)[1:] for store in machine.stores[:2])
    if (first, second) != ((0x4002_0818, CLOSE), (0x4002_0800, OUTPUTS)) or machine.outputs:
        return "the pins at boot"
    for register, (value, what) in AFTER_BOOT.items():
        if machine._reg.get(register) != value:
            return f"{what}: {machine._reg.get(register)}"
    if machine.unknown:
        return f"registers that the board does not use: {machine.unknown}"
    if machine._count() != 0 or machine._csr:
        return "the counter's start, or reset flags that stay"
    for cause in ResetCause:
        again = Cold(path, cause, adc=SUPPLIED)
        if ask(again, Decoder(), Hello(1), 1, HelloAck).reset_cause != cause:
            return f"reset cause {cause.name}"
    for never, (divider, prescaler, looks) in LOST_CLOCKS.items():
        kind = type("Without", (Deaf,), {"never": never})
        without = kind(path, adc=SUPPLIED)
        if without.looks != looks:
            return f"{without.looks} looks at oscillators that do not start"
        if without._reg[RCC_CR] != 1 << 16 | 1 << 24:
            return "a clock security system without crystal"
        if without._reg[0x4002_3804] != 16 | 336 << 6 | 7 << 24:
            return "the clock multiplier without crystal"
        if (without._reg[0x4001_1008], without._reg[0x4000_0028]) != (divider, prescaler):
            return "the rates without crystal or clock multiplier"
    stuck = type("Stuck", (Deaf,), {"switches": False})(path, adc=SUPPLIED)
    if (stuck._reg[0x4001_1008], stuck._reg[0x4000_0028]) != (17, 7):
        return "the rates behind the dividers of the internal oscillator"
    nonces = {ask(Cold(path, random=k), Decoder(), Hello(1), 1, HelloAck).session for k in (1, 2)}
    if len(nonces) != 2:
        return "the random generator does not count"
    return (
        flown(machine, decoder) or lived_through(path) or wrong_beyond(path) or wrong_inside(path)
    )


def flown(machine, decoder):
    """A plan, sensors, the watchdog's food, and the ring."""
    session = ask(machine, decoder, Hello(7), 1, HelloAck).session
    ask(machine, decoder, Arm(session), 2)
    ask(machine, decoder, Bearing(session, 1), 3)
    machine.outputs.clear()
    plan = Cmd(session, 1, 0, 400_000, (20_000, 0, 40_000, 0, 0, 0, 0, 0), (0,) * 8)
    began = machine.now_us
    if ask(machine, decoder, plan, 4) is None:
        return "no answer to a plan"
    machine.run_until(began + 120_000)
    edges = [(at - began, pins) for at, pins in machine.outputs]
    if edges != [(0, 0x105), (20_000, 0x104), (40_000, 0x100)]:
        return f"edges {edges}"
    report = next(m for m in reversed(said(machine, decoder)) if isinstance(m, Report))
    if (report.supply_mv, report.supply_pa) != (3000 * 33_000 // 4095, 2000 * 1_000_000 // 4095):
        return f"sensors {report.supply_mv} mV {report.supply_pa} Pa"
    if not 100 <= machine.feeds <= 200:
        return f"the watchdog was fed {machine.feeds} times in 120 ms"
    machine.feed(b"\x01" * 3000 + b"\0")
    machine.feed(b"\0")
    said(machine, decoder)
    if ask(machine, decoder, Ping(), 9) is None:
        return "no answer after more bytes than the ring holds"
    return ""


def lived_through(path):
    """A fault closes the valves and keeps the air until the watchdog's reset closes both."""
    machine, decoder = Cold(path, adc=SUPPLIED), Decoder()
    session = ask(machine, decoder, Hello(7), 1, HelloAck).session
    nonce = session
    ask(machine, decoder, Arm(session), 2)
    ask(machine, decoder, Bearing(session, 1), 3)
    plan = Cmd(session, 1, 0, 400_000, (300_000, *(0,) * 6, 300_000), (0,) * 8)
    ask(machine, decoder, plan, 4)
    if machine.pins != 0x181:
        return "the valves do not open"
    machine.run_until(machine.now_us + 5_300)
    machine._asleep, machine._pc = False, machine._vector(3 - 16)
    machine._uc.reg_write(arm.UC_ARM_REG_PRIMASK, 0)
    machine.settle()
    if machine.pins != 0x100:
        return "a fault does not close the valves, or shuts the air"
    machine.outputs.clear()
    machine.run_until(machine.now_us + 60_000)
    if any(pins & 0xFF for _, pins in machine.outputs):
        return "valves open after a fault"
    if machine.resets[-1] != ResetCause.WATCHDOG or machine.pins:
        return "the watchdog does not reset after a fault"
    again = ask(machine, Decoder(), Hello(7), 1, HelloAck)
    return "" if again and again.session != nonce else "the session after a reset"
