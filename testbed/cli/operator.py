"""Questions to the operator at the terminal: confirm arming, confirm a fault reset."""

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import click

from testbed.cli.live import LiveTable
from testbed.cli.refusal import errors
from testbed.cli.screen import print_text
from testbed.config import ConfigError, Experiment
from testbed.core.codes import FaultReport
from testbed.rig.fault_latch import FaultLatch


class Operator:
    """Asks the operator before actions that can hurt people; flags answer in scripts.

    Args:
        arm: `--arm` was given: arming is confirmed.
        reset: `--reset` was given: the previous fault was inspected.
        at_once: context in which Ctrl-C answers the open question with no.
    """

    def __init__(
        self,
        *,
        arm: bool = False,
        reset: bool = False,
        at_once: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._arm, self._reset, self._at_once = arm, reset, at_once
        self.live: LiveTable | None = None  # suspended while a question is open

    def must_be_there(self, rig: str) -> None:
        """Check that a question can be asked on the table.

        Raises:
            ConfigError: there is no terminal, and `--arm` is not given.
        """
        if rig == "table" and not self._arm and not sys.stdin.isatty():
            raise ConfigError(
                "command line", "--arm", "a terminal, to ask the operator, or --arm", "neither"
            )

    def latched(
        self, rig: str, experiment: Experiment, folder: str
    ) -> tuple[FaultLatch, FaultReport | None]:
        """The lab's fault latch, and its fault, which the operator has confirmed to reset.

        On the bench the fault is printed and reset without a question: the vehicles are simulated
        and start from their start poses again.

        Raises:
            ConfigError: the operator has not confirmed the reset.
        """
        latch = FaultLatch(rig, experiment.table.lab.network.lab, folder)
        fault = latch.fault
        if fault is None or self._reset:
            return latch, fault
        print_text(errors, f"latched: {fault.words}", "red")
        if rig != "table":
            errors.print("on the table a reset needs --reset", style="yellow")
            return latch, fault
        if not self._says_yes("Have you inspected every vehicle, and may the fault be reset?"):
            expected = "confirmation that the vehicles were inspected, or --reset"
            raise ConfigError("the run before", "--reset", expected, fault.words)
        return latch, fault

    def agree(self, names: Sequence[str]) -> bool:
        """Ask whether these vehicles may be armed."""
        vehicles = ", ".join(names)
        return self._arm or self._says_yes(
            f"All checks are green. Is the table clear of people, and may {vehicles} be armed?"
        )

    def _says_yes(self, question: str) -> bool:
        if not sys.stdin.isatty():
            return False
        aside = nullcontext() if self.live is None else self.live.aside()
        with aside, self._at_once():
            try:
                return click.confirm(question, default=False, err=True)
            except click.Abort:
                return False
        return False
