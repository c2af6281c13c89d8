"""All laws that an experiment file can name: the tagged union and the function that builds them.

To add a law: write its file, then add one line to `Controller` and one to `make_law`.
"""

from collections.abc import Sequence

from controllers.bifurcating import BifurcatingParams, bifurcating
from controllers.bounded_formation import BoundedFormationParams, bounded_formation
from controllers.bounded_leader import BoundedLeaderParams, bounded_leader
from controllers.bounded_leader_varying import BoundedLeaderVaryingParams, bounded_leader_varying
from controllers.collision_sliding import CollisionSlidingParams, collision_sliding
from controllers.connectivity_dynamic import ConnectivityDynamicParams, connectivity_dynamic
from controllers.connectivity_static import ConnectivityStaticParams, connectivity_static
from controllers.lqr import LqrParams, lqr
from controllers.mpc import MpcParams, mpc
from controllers.onnx_policy import OnnxParams, onnx_policy
from controllers.own_law import OwnLawParams, own_law
from controllers.pd import PdParams, pd
from controllers.scale import Scaled
from controllers.smc import SmcParams, smc
from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.law import Law

UsersLaw = OnnxParams | OwnLawParams  # it is in a user's file: its calls may be slow, or hang
Controller = (
    SotsmcParams
    | SmcParams
    | PdParams
    | LqrParams
    | MpcParams
    | ConnectivityStaticParams
    | ConnectivityDynamicParams
    | CollisionSlidingParams
    | BoundedFormationParams
    | BoundedLeaderParams
    | BoundedLeaderVaryingParams
    | BifurcatingParams
    | UsersLaw
)


def make_law(params: Controller, names: Sequence[str] = (), d: int = 2) -> Law:
    """The law that `params` describe, in SI units of the table.

    Args:
        params: the `[controller]` section of an experiment.
        names: of all satellites, in the order of `Body.vehicle_index`.
        d: positions have shape (d,).

    Raises:
        ValueError: `params` do not fit `d`, or the satellites.
    """
    return Scaled(_law(params, names, d), params.scale)


def _law(params: Controller, names: Sequence[str], d: int) -> Law:
    match params:
        case SotsmcParams():
            return sotsmc(params, d)
        case SmcParams():
            return smc(params, d)
        case PdParams():
            return pd(params)
        case LqrParams():
            return lqr(params, d)
        case MpcParams():
            return mpc(params, d)
        case ConnectivityStaticParams():
            return connectivity_static(params, names, d)
        case ConnectivityDynamicParams():
            return connectivity_dynamic(params, names, d)
        case CollisionSlidingParams():
            return collision_sliding(params, names, d)
        case BoundedFormationParams():
            return bounded_formation(params, names, d)
        case BoundedLeaderParams():
            return bounded_leader(params, names, d)
        case BoundedLeaderVaryingParams():
            return bounded_leader_varying(params, names, d)
        case BifurcatingParams():
            return bifurcating(params, d)
        case OnnxParams():
            return onnx_policy(params, d)
        case OwnLawParams():
            return own_law(params, names, d)
