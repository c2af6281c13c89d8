"""Parameters that a paper's assumptions rule out: does the law say so?"""

from msgspec import Struct

from controllers.catalogue import Controller, make_law
from testbed.reproduction.figure import Figure
from testbed.reproduction.targets import Measures


class Refusal(Struct, frozen=True, forbid_unknown_fields=True, tag="refusal"):
    """A law with something wrong, and words that its complaint must have."""

    controller: Controller
    names: tuple[str, ...]
    says: str
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def run_refusal(run: Refusal, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """`refused` is 1 if the law refuses, and says why."""
    try:
        make_law(run.controller, list(run.names), 3)
    except ValueError as error:
        return {"refused": [float(run.says in str(error))]}, []
    return {"refused": [0.0]}, []
