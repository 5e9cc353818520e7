r"""The information about every landmark, and its weakest direction.

    H_l = sum A_i' A_i over the measurements of landmark l           the poses taken for known
    M_l = H_l - H_lr H_rr^-1 H_rl,   r: everything but l              marginal: nothing taken for known

    H_l = sum_k w_k v_k v_k',   w_1 <= w_2 <= ...                     condition w_1 / w_d, weak direction v_1

A are whitened Jacobians, so w is 1/m^2 and 1 / sqrt(w_1) is the standard deviation along v_1. A sonar does not measure
the elevation. For its point v_1 is the tangent of the arc of the first sighting, unless the motion has shown the
elevation. `elevation_angle` says how far from it.

The marginal information is the inverse of the marginal covariance,

    M_l = V (V' Sigma_ll V)^-1 V',   Sigma = (H + W)^-1

where V are the directions that the measurements of the landmark see. W gives it weight along the others, A_l v = 0.
These are joined to nothing else, so that the weight of one landmark changes the covariance of no other.
"""

from dataclasses import dataclass

import numpy as np

from factors.keys import Keys, Kind
from models import SE3, R
from models.algebra import Array, Mask, apply, congruence, dot
from models.errors import GraphError
from models.sensors import cartesian, point_in_frame, spherical
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.linear.default import default_solver
from nls.linear.factorization import SINGULAR, SingularSystemError
from nls.linear.limits import default_limit
from nls.linear.null_space import own_information
from nls.linear.underconstrained import underconstrained
from nls.starts.landmarks import first_arcs
from nls.system import LinearSystem
from nls.values import Values


@dataclass(frozen=True)
class LandmarkInformation:
    """Information about n landmarks, in the order of `keys`.

    Attributes
    ----------
    keys : the landmarks.
    information : (n, d, d) H_l, the poses known, 1/m^2.
    marginal : (n, d, d) M_l, nothing known; None where it was not asked for.
    eigenvalues : (n, d) of M_l where asked for, else of H_l, rising, 1/m^2.
    weak : (n, d) unit vectors of the world, the direction of the smallest.
    elevation_angle : (n,) between `weak` and the elevation direction at the first sighting by a sonar, rad, 0 to pi/2;
        nan where no sonar saw the landmark.
    """

    keys: Keys
    information: Array
    marginal: Array | None
    eigenvalues: Array
    weak: Array
    elevation_angle: Array

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def condition(self) -> Array:
        """Smallest over largest eigenvalue (n,); 0 where a direction is free, or nothing is known at all."""
        largest = self.eigenvalues[:, -1]
        return np.asarray(self.eigenvalues[:, 0].clip(min=0.0) / np.where(largest > 0, largest, 1.0))

    @property
    def sigma(self) -> Array:
        """Standard deviation along the weak direction (n,), m; inf where it is free."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.sqrt(self.eigenvalues[:, 0].clip(min=0.0)))

    def degenerate(self, tau: float = 1e-3) -> Mask:
        """Which landmarks (n,) have a direction that `truncated_inverse` leaves out."""
        return np.asarray(self.condition <= tau)

    def report(self, most: int = 10, tau: float = 1e-3) -> str:
        """The worst landmarks in words, one a line."""
        worst = np.argsort(self.condition, kind="stable")[:most]
        weak = int(self.degenerate(tau).sum())
        lines = [f"{weak} of {len(self)} landmarks have a direction of relative information <= {tau:g}"]
        for k in worst:
            known = f"known to {self.sigma[k]:.3g} m" if self.condition[k] > SINGULAR else "free"
            angle = np.degrees(self.elevation_angle[k])
            arc = "" if np.isnan(angle) else f", {angle:.0f} deg from the elevation at its first sighting"
            along = ", ".join(f"{c:.2f}" for c in self.weak[k] + 0.0)
            lines.append(f"{self.keys[[k]]!r}: {known} along ({along}){arc}; condition {self.condition[k]:.1e}")
        return "\n".join(lines)


def landmark_information(
    graph: FactorGraph, values: Values, kind: Kind | str, marginal: bool = False
) -> LandmarkInformation:
    """Information about every landmark of a kind, at some values.

    Parameters
    ----------
    graph : the measurements.
    values : where they are linearized.
    kind : of the landmarks, points in R(2) or R(3).
    marginal : whether to take into account that the poses, and everything else, are only estimated. Costs a
        factorization and the blocks of its inverse.

    Returns
    -------
    LandmarkInformation

    Raises
    ------
    GraphError
        Landmarks that are no points.
    UnderconstrainedError
        For the marginal: something other than landmarks is free.

    Examples
    --------
    A point seen by a sonar before and after a surge of a meter, all on the plane of elevation 0:

    >>> import numpy as np
    >>> from factors import Diagonal, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.analysis import landmark_information
    >>> x, l = kinds("x", "l")
    >>> values = Values({x: (SE3, np.array([[0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 1]])), l: (R(3), [4, 1, 0])})
    >>> contacts = RangeAzimuth(x[[0, 1]], l[0], [[4.123, 0.245], [3.162, 0.322]], Diagonal([0.01, 0.005]))
    >>> information = landmark_information(FactorGraph([contacts]), values, l)
    >>> information.condition, information.weak, information.elevation_angle
    (array([0.]), array([[0., 0., 1.]]), array([0.]))
    """
    name = kind.name if isinstance(kind, Kind) else kind
    stack = values.stack(name)
    d = stack.manifold.dim
    if stack.manifold not in (R(2), R(3)):
        raise GraphError(f"landmark_information: {name} is in {stack.manifold}, expected points in R(2) or R(3)")
    every = graph.pattern(values)
    system = LinearSystem.at(every, values)
    H = own_information(system, every.offsets[name] + np.arange(len(stack)), d)
    M = None
    if marginal:
        decided = choose_gauge("first", every, values, fixed_variables(graph.fixed, values))
        M = _marginal(LinearSystem(every.holding(decided.held), system.blocks, system.b), name, H)
    w, V = np.linalg.eigh(H if M is None else M)
    weak = V[:, :, 0] * np.where(V[:, -1, :1] < 0, -1.0, 1.0)  # of the two unit vectors the one that points down
    angle = _elevation_angle(graph, values, name, weak)
    return LandmarkInformation(Keys(name, stack.numbers), H, M, w, weak, angle)


def _elevation_angle(graph: FactorGraph, values: Values, kind: str, weak: Array) -> Array:
    """Angle (n,) between lines: the weak directions and the arcs of the first sightings; nan without one."""
    angle = np.full(len(weak), np.nan)
    for arcs in first_arcs(graph.factors, values):
        if arcs.kind == kind:
            p, _ = point_in_frame(SE3, arcs.S, values.stack(kind).X[arcs.rows])
            arc = apply(SE3.rotation(arcs.S), cartesian(spherical(p)[0])[1][:, :, 2])  # dp/del, in axes of the world
            cosine = np.abs(dot(weak[arcs.rows], arc)) / np.linalg.norm(arc, axis=1)
            angle[arcs.rows] = np.arccos(np.minimum(cosine, 1.0))  # 1 but for rounding
    return angle


def _marginal(system: LinearSystem, kind: str, H: Array) -> Array:
    """M_l (n, d, d) of all landmarks of a kind from their H_l; H_l where they are held."""
    pattern, d = system.pattern, H.shape[1]
    begin = pattern.offsets[kind]
    free = np.flatnonzero(~pattern.held[begin : begin + len(H)])
    place = (np.cumsum(~pattern.held) - 1)[begin + free]
    w, V = np.linalg.eigh(H[free])
    V = V * (w > SINGULAR * w[:, -1:])[:, None, :]
    onto = V @ V.mT
    unseen = np.eye(d) - onto  # projections on what its own measurements leave free
    weight = np.trace(H[free], axis1=1, axis2=2) / d
    W = np.where(weight > 0, weight, 1.0)[:, None, None] * unseen
    blocks = system.H_blocks.copy()
    blocks[pattern.blocks.diagonal[place, None] + np.arange(d * d)] += W.reshape(-1, d * d)
    try:
        factorization = default_solver(pattern.n).prepared(pattern).factorize(blocks)
    except SingularSystemError as error:
        raise underconstrained(system) from error
    Sigma = factorization.inverse_blocks(place, place, default_limit()).reshape(-1, d, d)
    Sigma = congruence(onto, Sigma)
    size = np.maximum(np.trace(Sigma, axis1=1, axis2=2), np.finfo(float).tiny)[:, None, None]
    M = H.copy()
    M[free] = congruence(onto, np.linalg.inv(Sigma + size * unseen))  # V (V'Sigma V)^-1 V'
    return M
