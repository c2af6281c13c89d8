"""Every law that an experiment file can name: the tagged union and who builds what.

To add a law: write its file, then add one line to `Controller` and one to `make_law`.
"""

from controllers.bifurcating import BifurcatingParams, bifurcating
from controllers.pd import PdParams, pd
from controllers.scale import Scaled
from controllers.smc import SmcParams, smc
from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.law import Law

Controller = SotsmcParams | SmcParams | PdParams | BifurcatingParams


def make_law(params: Controller, d: int = 2) -> Law:
    """The law that `params` describe, in the units of this world, for positions of shape (d,)."""
    match params:
        case SotsmcParams():
            law = sotsmc(params, d)
        case SmcParams():
            law = smc(params, d)
        case PdParams():
            law = pd(params)
        case BifurcatingParams():
            law = bifurcating(params, d)
    return Scaled(law, params.scale)
