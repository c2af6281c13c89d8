"""The operator at the terminal: says yes to arming, and that a fault was looked at."""

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import click

from testbed.cli.live import LiveTable
from testbed.cli.refusal import errors
from testbed.config import ConfigError, Experiment
from testbed.rig.fault_latch import FaultLatch


class Operator:
    """Asked where somebody may be hurt; flags answer for scripts.

    Args:
        arm: `--arm`, yes to arming.
        reset: `--reset`, the fault of the run before was looked at.
        at_once: while a question is open Ctrl-C is an answer to it.
    """

    def __init__(
        self,
        *,
        arm: bool = False,
        reset: bool = False,
        at_once: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._arm, self._reset, self._at_once = arm, reset, at_once
        self.live: LiveTable | None = None  # what has to step aside for a question

    def must_be_there(self, rig: str) -> None:
        """On the table somebody is asked.

        Raises:
            ConfigError: nobody can be.
        """
        if rig == "table" and not self._arm and not sys.stdin.isatty():
            raise ConfigError(
                "command line", "--arm", "somebody at a terminal who is asked, or --arm", "neither"
            )

    def latched(
        self, rig: str, experiment: Experiment, folder: str
    ) -> tuple[FaultLatch, str | None]:
        """The lab's latch, and the fault in it that the operator wants to be reset.

        On the bench it is said and reset: the vehicles are put back to their starts, and nobody is
        there who could look.

        Raises:
            ConfigError: nobody has looked at it.
        """
        latch = FaultLatch(rig, experiment.table.lab.network.lab, folder)
        fault = latch.fault
        if fault is None or self._reset:
            return latch, fault
        errors.print(f"latched: {fault}", style="red", markup=False, soft_wrap=True)
        if rig != "table":
            errors.print("on the table it would take --reset", style="yellow")
            return latch, fault
        if not self._says_yes("Have you looked at every vehicle, and may the fault be reset?"):
            expected = "somebody who has looked at the vehicles and says so, or --reset"
            raise ConfigError("the run before", "--reset", expected, fault)
        return latch, fault

    def agree(self, names: Sequence[str]) -> bool:
        """Whether these vehicles may be armed."""
        vehicles = ", ".join(names)
        return self._arm or self._says_yes(
            f"All checks are green. Is everybody clear of the table, and may {vehicles} be armed?"
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
