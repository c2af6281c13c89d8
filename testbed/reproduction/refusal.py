"""Checks that laws reject parameters that violate a paper's assumptions."""

from msgspec import Struct

from controllers.catalogue import Controller, make_law
from testbed.reproduction.figure import Figure
from testbed.reproduction.targets import Measures


class RefusedLaw(Struct, frozen=True, forbid_unknown_fields=True, tag="refusal"):
    """A law with invalid parameters, and text that its error must contain."""

    controller: Controller
    names: tuple[str, ...]
    says: str
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def run_refusal(run: RefusedLaw, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """`refused` is 1 if the law raises the expected error."""
    try:
        make_law(run.controller, list(run.names), 3)
    except ValueError as error:
        return {"refused": [float(run.says in str(error))]}, []
    return {"refused": [0.0]}, []
