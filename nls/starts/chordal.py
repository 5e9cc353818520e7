r"""Chordal relaxation: all rotations from one linear system, then all translations from another.

Rotations minimize sum kappa |M_j - M_i R_ij|_F^2 over matrices M, without the constraint that they are rotations, and
are projected afterwards; translations then minimize sum tau |t_j - t_i - R_i t_ij|^2. Fixed poses keep their values;
in a component without any, the first pose does. kappa and tau are the mean informations of the two blocks. Both systems
have the pattern of the pose graph, so one elimination order serves both; in the plane the rotation is two numbers (cos,
sin) instead of nine.

Source: L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM", ICRA 2015.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from models import SE2, SE3
from models.algebra import Array, apply, product, wrap
from models.errors import UnderconstrainedError
from models.manifolds.so2 import rotation2
from models.manifolds.so3 import quaternion_from_matrix, rotation3
from nls.graph import FactorGraph
from nls.hessian import Hessian
from nls.linear import best_factorization
from nls.linear.base import SingularSystemError
from nls.linear.normal import NormalState
from nls.starts.edges import PoseEdges, pose_edges
from nls.values import Values

__all__ = ["chordal"]

Index = npt.NDArray[np.intp]
VANISHING = 1e-9  # a relaxed rotation this small has lost its direction to contradicting measurements


def chordal(graph: FactorGraph, values: Values) -> Values:
    """Start of the poses of SE2 and SE3 by chordal relaxation; other variables stay.

    Parameters
    ----------
    graph : its `Between` factors are used.
    values : every variable; of the poses only the first of each component matters.

    Returns
    -------
    Values

    Raises
    ------
    UnderconstrainedError
        Measurements without rotation or translation information leave a pose free, or contradict each other so that a
        rotation cancels.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.starts import chordal
    >>> (x,) = kinds("x")
    >>> square = Between(x[[0, 1, 2, 3]], x[[1, 2, 3, 0]], [1.0, 0.0, np.pi / 2], Isotropic(1))
    >>> chordal(FactorGraph([square]), Values({x: (SE2, SE2.identity(4))}))[x[1:4]].round(6).tolist()
    [[1.0, 0.0, 1.570796], [1.0, 1.0, -3.141593], [-0.0, 1.0, -1.570796]]
    """
    for edges in pose_edges(graph, values):
        if edges.group in (SE2, SE3):
            values = edges.replaced(values, _relax(edges, edges.stack(values)))
    return values


def _relax(edges: PoseEdges, X: Array) -> Array:
    if edges.fixed.all():
        return X
    plane = edges.group is SE2
    d = 2 if plane else 3
    system = _Laplacian(edges)
    R, t = (rotation2(edges.z[:, 2]) if plane else rotation3(edges.z[:, 3:])), edges.z[:, :d]
    kappa, tau = edges.weights(slice(d, None)), edges.weights(slice(0, d))
    start = edges.group.rotation(X)

    if plane:  # y = (cos, sin): y_j = R_ij y_i
        y = system.solve(kappa, R, None, start[:, :, :1])[..., 0]
        size = np.hypot(y[:, 0], y[:, 1])
        rotations = rotation2(np.arctan2(y[:, 1], y[:, 0]))
    else:  # y = M', three columns: y_j = R_ij' y_i
        M = system.solve(kappa, R.mT, None, start.mT).mT
        rotations, size = nearest_rotation(M)
    if (size[system.free] < VANISHING).any():
        raise UnderconstrainedError(
            "chordal relaxation: contradicting rotations cancel at a pose; start from 'odometry' or 'spanning-tree'"
        )
    difference = apply(rotations[edges.i], t)
    position = system.solve(tau, np.ones((1, 1, 1)), difference[:, None], X[:, None, :d])[:, 0]

    out = np.array(X)
    free = system.free
    out[free, :d] = position[free]
    out[free, d:] = (
        wrap(np.arctan2(rotations[free, 1, 0], rotations[free, 0, 0]))[:, None]
        if plane
        else quaternion_from_matrix(rotations[free])
    )
    return out


def nearest_rotation(M: Array) -> tuple[Array, Array]:
    """Rotation (n, 3, 3) nearest to each matrix, U diag(1, 1, det UV') V', and the middle singular value (n,).

    Where the second singular value vanishes too, the nearest rotation is not unique.
    """
    U, s, Vt = np.linalg.svd(M)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return U @ Vt, s[..., 1]


class _Laplacian:
    """Minimizers of sum w |y_j - T y_i - c|^2 over blocks y, T orthogonal, the first pose of each component held."""

    def __init__(self, edges: PoseEdges) -> None:
        free = edges.touched
        free[edges.roots()] = False
        self.free = np.flatnonzero(free)
        number = np.full(edges.n, -1, dtype=np.intp)
        number[self.free] = np.arange(len(self.free))
        self.edges, self.i, self.j = edges, number[edges.i], number[edges.j]
        self.both = np.flatnonzero((self.i >= 0) & (self.j >= 0))
        self._order: Index | None = None

    def order(self, u: Index, v: Index, V: int) -> Index:
        """Elimination order, found once for both systems."""
        if self._order is None:
            self._order = best_factorization().order(u, v, V)
        return self._order

    def solve(self, w: Array, T: Array, c: Array | None, value: Array) -> Array:
        """y (n, d, k) for weights w (m,), T (m or 1, d, d), c (m, d, k) or None for 0; held ones keep their value."""
        V, d = len(self.free), T.shape[-1]
        i, j, both = self.i, self.j, self.both
        T = np.broadcast_to(T, (len(w), d, d))
        off = -(w[:, None, None] * T)[both]  # block (j, i)
        degree = self._sum(w[:, None], i) + self._sum(w[:, None], j)
        diagonal = degree[:, :, None] * np.eye(d)
        S = np.concatenate([diagonal.reshape(-1), off.reshape(-1)])
        at = np.arange(max(V, len(both)), dtype=np.intp) * d * d
        dims = np.full(V, d, dtype=np.intp)
        hessian = Hessian(dims, j[both], i[both], at[:V], V * d * d + at[: len(both)], self.order)
        state = NormalState(hessian, best_factorization())

        # H y = g: what is known about y_j is T y_i + c with y_i held, and about y_i it is T'(y_j - c) with y_j held
        known = np.zeros((len(w), d, value.shape[-1])) if c is None else c
        to_j = known + np.where((i < 0)[:, None, None], product(T, value[self.edges.i]), 0.0)
        to_i = product(T.mT, np.where((j < 0)[:, None, None], value[self.edges.j], 0.0) - known)
        weight = w[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # a start that is not finite is refused when it is evaluated
            g = self._sum(weight * to_j.reshape(len(w), -1), j) + self._sum(weight * to_i.reshape(len(w), -1), i)
        try:
            state.factorize(S)
        except SingularSystemError as error:
            raise UnderconstrainedError(
                "chordal relaxation: some poses have no rotation or no translation measurement; start from 'odometry'"
            ) from error
        y = np.array(value)
        y[self.free] = state.solve(g.reshape(V * d, -1)).reshape(V, d, -1)
        return y

    def _sum(self, x: Array, node: Index) -> Array:
        """Rows of x (m, k) summed by node, (V, k)."""
        k = np.flatnonzero(node >= 0)
        incidence = sp.csr_array((np.ones(len(k)), (node[k], k)), shape=(len(self.free), len(x)))
        return np.asarray(incidence @ x)
