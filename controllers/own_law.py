"""User-defined laws: a Python file outside the package, named in the experiment.

    [controller]
    type = "python"
    law = "my_law.py:Mine"              # a file, relative to this one, and a name in it
    parameters = { stiffness = 0.2 }

`Mine` is called with the parameters, which must match its annotations. If it has parameters `names`
or `d`, it also gets the satellites' names in the order of `Body.vehicle_index` and the number of
coordinates of a position. It returns a complete law, such as a `CompiledLaw`, or an object that has

    force(own, neighbours, world, t)            the force, shape (d,) [N], or
    rate(law_state, own, neighbours, world, t)  the force and the rate of a state (n,) of its own

and, if needed, `initial`, `jump`, `broadcast` and `message_size` as in `testbed.core.law`. An
object in plain Python is integrated with steps of `guidance.step_s`, or of its own `step_s` [s] if
that is longer, but with at least one step per jet period. It gets read-only arrays, and the norm of
its force is limited to `own.max_force`; a complete law limits its force itself.

Instead of a file, `law` may name an entry point of an installed package, in the group
`testbed.laws`.

The file is read and executed again for each law, so edits always take effect and laws share no
module state, neither between vehicles nor between runs in the same process. A file with functions
compiled by numba is executed once per content. `sha256` pins the content; a file with another
digest is rejected.
"""

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct, field

from controllers.law_file import UnusableLawError, blame, maker, source_of
from controllers.plain_law import PlainLaw, Watched
from controllers.scale import Scale
from testbed.core import plugin
from testbed.core.law import Body, Discs, Goal, Neighbours, World


class OwnLawParams(Struct, frozen=True, forbid_unknown_fields=True, tag="python"):
    """Location of the law and its parameters."""

    law: str  # "path.py:Name", or an entry point
    parameters: dict[str, Any] = field(default_factory=dict)
    sha256: str | None = None  # of the file; null: any content
    scale: Scale = field(default_factory=Scale)


def parameter_type(made: Callable[..., Any]) -> type[Struct]:
    """The parameters of a law as a struct that refuses unknown keys.

    Raises:
        UnusableLawError: `made` is a law's method and not what makes a law; or its parameters
            cannot be named in an experiment.
    """
    try:
        arguments = () if isinstance(made, type) else (*inspect.signature(made).parameters,)
        if "own" in arguments:
            expected = "a class, or a function that returns a law"
            found = f"`{made.__name__}` takes {', '.join(arguments)} like a law's own method"
            raise UnusableLawError("law", expected, found)
        return plugin.option_type(made, plugin.PROVIDED[plugin.LAWS])
    except plugin.PluginError as error:
        raise UnusableLawError("law", f"a law with {error.expected}", error.found) from error


def own_law(params: OwnLawParams, names: Sequence[str], d: int, *, limited: bool = True) -> Watched:
    """The law for positions of shape (d,); `limited`: the force of a law in plain Python is.

    Raises:
        UnusableLawError: see `maker`; or the parameters are wrong or the object is not a law.
    """
    made = maker(params.law, params.sha256)
    path = source_of(params.law)
    return law_of(made, params.parameters, names, d, path, limited=limited)


def law_of(
    made: Callable[..., Any], parameters: dict[str, Any], names: Sequence[str], d: int,
    path: Path | None = None, *, limited: bool = True,
) -> Watched:  # fmt: skip
    """The law that a class or function returns; `path` of its file is for messages.

    Raises:
        UnusableLawError: the parameters do not fit, or the result is not a law.
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
        raise UnusableLawError("parameters", "values it accepts", blame(error, path)) from error
    whole = callable(getattr(law, "propagate", None))
    return Watched(law if whole else PlainLaw(law, path, limited=limited), path)


def try_out(law: Watched, satellites: int, d: int = 2) -> None:
    """Call each function of a law once, so that errors show before a flight and not in it.

    Raises:
        LawError: the law fails.
    """

    def somewhere(first: float, n: int) -> np.ndarray:
        return first + 0.7 * np.arange(n * d).reshape(n, d)

    still = np.zeros(d)
    own = Body(somewhere(-1.3, 1)[0], still + 0.01, 10.0, still, still, 1.0, 0)
    goal = Goal(somewhere(1.1, 1)[0], still, still, still)
    n = max(0, satellites - 1)
    messages = np.zeros((n, law.message_size))
    others = Neighbours(
        somewhere(0.4, n),
        np.zeros((n, d)),
        np.full(n, 0.5),
        np.arange(1, n + 1),
        messages,
        np.zeros(n),
    )
    world = World(goal, Discs(somewhere(3.0, 1), np.zeros((1, d)), np.full(1, 0.5)))
    law.try_out(own, others, world)
