"""A law of one's own: a Python file outside the package, named in the experiment.

    [controller]
    type = "python"
    law = "my_law.py:Mine"              # a file, relative to this one, and a name in it
    parameters = { stiffness = 0.2 }

`Mine` is called with the parameters, which must fit its annotations; if it has parameters `names`
or `d`, it is also told the satellites' names in the order of `Body.vehicle_index`, and how many
coordinates a position has. What it returns is a law whole, such as a `CompiledLaw`, or an object
that has

    force(own, neighbours, world, t)            the force, shape (d,) [N], or
    rate(law_state, own, neighbours, world, t)  the force and the rate of a state (n,) of its own

and, where it needs them, `initial`, `jump`, `broadcast` and `message_size` as in
`testbed.core.law`. An object in plain Python takes steps of `guidance.step_s`, or of its own
`step_s` [s] if that is longer.

Instead of a file, `law` may name an entry point of an installed package, in the group
`testbed.laws`.

The file is read and executed anew for each law that is made, so an edit is always noticed, and what
a law keeps in its module is its own: neither another vehicle nor another run of the same process
finds it. A file with functions compiled by numba is executed once per content. `sha256` is the
content that is meant; another is refused.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct, field

from controllers.law_file import UnusableLawError, blame, maker, source_of
from controllers.plain_law import LawError, PlainLaw, Watched
from controllers.scale import Scale
from testbed.core import plugin
from testbed.core.law import Body, Discs, Goal, Law, Neighbours, World


class OwnLawParams(Struct, frozen=True, forbid_unknown_fields=True, tag="python"):
    """Where the law is and what it is called with."""

    law: str  # "path.py:Name", or an entry point
    parameters: dict[str, Any] = field(default_factory=dict)
    sha256: str | None = None  # of the file; null: whatever it holds
    scale: Scale = field(default_factory=Scale)


def parameter_type(made: Callable[..., Any]) -> type[Struct]:
    """The parameters of a law as a struct that refuses unknown keys."""
    try:
        return plugin.option_type(made, plugin.TOLD[plugin.LAWS])
    except plugin.PluginError as error:
        raise UnusableLawError("law", f"a law with {error.expected}", error.found) from error


def own_law(params: OwnLawParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,).

    Raises:
        UnusableLawError: see `maker`; or the parameters do not fit, or what is made is no law.
    """
    made = maker(params.law, params.sha256)
    return law_of(made, params.parameters, names, d, source_of(params.law))


def law_of(
    made: Callable[..., Any], parameters: dict[str, Any], names: Sequence[str], d: int,
    path: Path | None = None,
) -> Law:  # fmt: skip
    """The law that a class or function makes; `path` is of its file, for what is said of it.

    Raises:
        UnusableLawError: the parameters do not fit, or what is made is no law.
    """
    try:
        values = msgspec.convert(parameters, parameter_type(made))
    except msgspec.ValidationError as error:
        raise UnusableLawError("parameters", f"those of {made.__name__}", str(error)) from None
    try:
        law = plugin.call(made, values, {"names": tuple(names), "d": d})
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # it is the user's code, and may call sys.exit
        raise UnusableLawError("parameters", "some that it accepts", blame(error, path)) from error
    whole = callable(getattr(law, "propagate", None))
    return Watched(law if whole else PlainLaw(law, path), path)


def try_out(law: Law, satellites: int, d: int = 2) -> None:
    """Ask a law once what it would do, so that it fails before a flight rather than in one.

    Raises:
        LawError: it fails.
    """

    def somewhere(first: float, n: int) -> np.ndarray:
        return first + 0.7 * np.arange(n * d).reshape(n, d)

    still = np.zeros(d)
    own = Body(somewhere(-1.3, 1)[0], still + 0.01, 10.0, still, still, 1.0, 0)
    goal = Goal(somewhere(1.1, 1)[0], still, still, still)
    n = max(0, satellites - 1)
    told = np.zeros((n, law.message_size))
    others = Neighbours(
        somewhere(0.4, n), np.zeros((n, d)), np.full(n, 0.5), np.arange(1, n + 1), told, np.zeros(n)
    )
    world = World(goal, Discs(somewhere(3.0, 1), np.zeros((1, d)), np.full(1, 0.5)))
    force, _ = law.rate(law.initial(own, others, world), own, others, world, 0.0)
    if not np.isfinite(force).all():
        raise LawError(f"a force that is no number, {force}, the first time it was asked")
