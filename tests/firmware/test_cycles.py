"""On a chip whose instructions take time: no byte is lost, and the alarm's interrupt is bounded."""

import pytest
from cycles import BYTE_US, FAST_MHZ, SLOW_MHZ, Timed

from firmware_interface.compiler import image
from firmware_interface.frame import Decoder, encode_message
from firmware_interface.messages import Ack, Arm, Cmd, Hello, HelloAck, Result
from firmware_interface.stm32 import NVIC_IPR, TIM2, USART1

pytestmark = pytest.mark.usefixtures("a_cross_compiler")

PLANS = 6  # one after the other, without a pause on the line
LONGEST = 6_000  # cycles of the alarm's interrupt


class WithoutMultiplier(Timed):
    """The core stays at 16 MHz."""

    multiplies = False


class AlarmFirst(WithoutMultiplier):
    """The priorities as they were: the alarm above the line."""

    def priority(self, number):
        return {TIM2: 0, USART1: 0x80}[number]


@pytest.fixture
def path(limits):
    return image(limits).with_suffix(".bin")


def answers(machine, decoder):
    found = [frame.message for frame in decoder.feed(bytes(machine.sent))]
    machine.sent.clear()
    return found


def flown(machine):
    """Plans for all valves at the full rate of the line: their answers."""
    decoder = Decoder()
    machine.send(encode_message(Hello(7), 1, 0), machine.now_us + 100)
    machine.run_until(machine.now_us + 10_000)
    session = next(m for m in answers(machine, decoder) if isinstance(m, HelloAck)).session
    machine.send(encode_message(Arm(session), 2, 0), machine.now_us + 100)
    machine.run_until(machine.now_us + 10_000)
    answers(machine, decoder)
    data = b""
    for number in range(1, PLANS + 1):
        on = tuple(20_000 + 100 * (number + k) for k in range(4)) + (0,) * 4
        data += encode_message(Cmd(session, number, 0, 400_000, on, (0,) * 8), 2 + number, 0)
    machine.send(data, machine.now_us + 100)
    machine.run_until(machine.now_us + len(data) * BYTE_US + 25_000)
    return [m for m in answers(machine, decoder) if isinstance(m, Ack)]


@pytest.mark.parametrize(("kind", "mhz"), [(Timed, FAST_MHZ), (WithoutMultiplier, SLOW_MHZ)])
def test_no_byte_is_lost_at_the_full_rate_of_the_line(path, kind, mhz):
    machine = kind(path, adc=(3000, 2000))
    assert machine.mhz == mhz
    acks = flown(machine)
    assert [ack.result for ack in acks] == [Result.OK] * PLANS
    assert machine.lost == 0
    assert machine.waited_us < 0.75 * BYTE_US
    assert machine.longest_us[TIM2] * mhz < LONGEST
    assert machine.unknown == set()


def test_with_the_alarm_above_the_line_bytes_are_lost_and_this_test_sees_it(path):
    machine = AlarmFirst(path, adc=(3000, 2000))
    machine.send(encode_message(Hello(7), 1, 0) * 3, machine.now_us + 100)
    machine.run_until(machine.now_us + 10_000)
    assert machine.lost > 0


def test_the_line_comes_before_the_alarm(path):
    machine = Timed(path)
    assert machine._reg[NVIC_IPR + USART1] < machine._reg[NVIC_IPR + TIM2]
