"""The port: its registers and behaviour, and faults planted in it that the check must notice."""

import tempfile
from pathlib import Path

import port_mutation
import pytest
from port_check import wrong_with

pytestmark = pytest.mark.usefixtures("a_cross_compiler")

# file, what is there, what instead
FAULTS = {
    "alarm above the line": ("timer.h", "ALARM_PRIORITY 0x80u", "ALARM_PRIORITY 0x00u"),
    "converter frozen": ("main.c", "ADC1_CR2 |= ADC_CR2_SWSTART;", ";"),
    "no clock security": ("main.c", "(crystal ? RCC_CR_CSSON : 0u)", "0u"),
    "no pull-up": ("main.c", "GPIOA_PUPDR |= 1u << 20;", ";"),
    "watchdog not fed": ("main.c", "IWDG_KR = IWDG_KR_FEED;", ";"),
    "watchdog fed late": ("startup.c", "    IWDG_KR = IWDG_KR_FEED;\n", ""),
    "watchdog longer": ("startup.c", "IWDG_RLR = 400u;", "IWDG_RLR = 4000u;"),
    "watchdog locked": ("startup.c", "    IWDG_KR = IWDG_KR_UNLOCK;\n", ""),
    "memory not cleared": ("startup.c", "        *to++ = 0;\n", "        to++;\n"),
    "generator not read": ("main.c", "kept.noise[0] ^=", "(void)"),
    "rates of a stuck switch": ("main.c", "(clocks){8000000u, 8", "(clocks){16000000u, 16"),
    "outputs before closed": ("board.h", "    board_drive(0, 0);\n", ""),
    "a fault shuts the air": ("board.h", "VALVE_PINS << 16;", "0x1ffu << 16;"),
    "a fault leaves valves open": ("startup.c", "    board_close_valves();\n", ""),
    "reset flags pile up": ("main.c", "RCC_CSR |= RCC_CSR_RMVF;", ";"),
    "old flags of the timer": ("timer_tim2.c", "TIM2_SR = 0;", ";"),
    "a passed alarm waits": ("timer_tim2.c", "        TIM2_EGR = TIM2_EGR_CC1G;", "        ;"),
    "alarm inside the core": ("main.c", '"msr basepri, %0" ::"r"(ALARM_PRIORITY)', '"" ::"r"(0)'),
    "a slow line": ("main.c", "USART1_CR1 |= USART_CR1_TXEIE;", ";"),
    "window watchdog": ("main.c", "RCC_CSR_IWDGRSTF | RCC_CSR_WWDGRSTF", "RCC_CSR_IWDGRSTF"),
    "a ring one larger": ("main.c", "received.out < RECEIVE_MAX", "received.out <= RECEIVE_MAX"),
    "sensors without clock": ("main.c", "RCC_APB2ENR |= RCC_APB2ENR_ADC1;", ""),
    "one wait state": ("registers.h", "(5u | (1u << 8)", "(1u | (1u << 8)"),
}


def built(folder, fault):
    name, was, now = fault
    code = (port_mutation.CHIP / name).read_text()
    assert code.count(was) == 1, was
    begin = len(code[: code.index(was)].encode())
    source = port_mutation.CHIP / name
    mutant = port_mutation.Mutant(source, begin, begin + len(was.encode()), now, "", was, now)
    assert port_mutation.built(folder, mutant) is not None
    return folder / "bin"


def test_nothing_is_wrong_with_the_image(tmp_path: Path):
    assert port_mutation.built(tmp_path, None) is not None
    assert wrong_with(tmp_path / "bin") == ""


@pytest.mark.parametrize("one", port_mutation.SURVIVORS, ids=lambda one: one["now"][:50])
def test_every_survivor_is_a_fault_of_this_port_and_is_explained(one):
    name = tuple(one[part] for part in port_mutation.NAMES)
    faults = port_mutation.port_mutants()
    assert name in {(f.source.name, f.function, f.was, f.now) for f in faults}
    assert len(one["why"].split()) >= 4


def test_a_sample_of_the_faults_is_noticed_today():
    with tempfile.TemporaryDirectory() as place:
        healthy = port_mutation.built(Path(place), None)
    explained = {(one["was"], one["now"]) for one in port_mutation.SURVIVORS}
    for fault in port_mutation.port_mutants()[11::130]:
        if port_mutation.tried(fault, healthy) == "survived":
            assert (fault.was, fault.now) in explained


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_a_planted_fault_is_noticed(tmp_path: Path, fault):
    try:
        wrong = wrong_with(built(tmp_path, fault))
    except Exception as error:  # a broken image breaks the emulator in any way
        wrong = str(error)
    assert wrong
