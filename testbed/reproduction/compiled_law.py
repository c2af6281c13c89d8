"""Laws of the catalogue with access to their compiled gains, for flights in a paper's units."""

from collections.abc import Sequence

from controllers.catalogue import Controller, make_law
from controllers.scale import Scale, Scaled
from testbed.core.law import CompiledLaw


def gains_of(controller: Controller, names: Sequence[str], d: int) -> CompiledLaw:
    """The law without scaling.

    Raises:
        ValueError: the law is scaled or not compiled, or its parameters are wrong.
    """
    if controller.scale != Scale():
        raise ValueError(f"expected a law in the paper's units, found {controller.scale}")
    law = make_law(controller, names, d)
    if not (isinstance(law, Scaled) and isinstance(law.law, CompiledLaw)):
        raise ValueError(f"expected a compiled law, found {type(law).__name__}")
    return law.law
