r"""Chordal relaxation: all rotations from one linear system, then all translations from another.

Rotations minimize sum kappa |M_j - M_i R_ij|_F^2 over matrices M, without the constraint that they are rotations, and
are projected afterwards; translations then minimize sum tau |t_j - t_i - R_i t_ij|^2. Fixed poses keep their values;
in a component without any, the first pose does. kappa and tau are the mean informations of the two blocks. Both systems
have the pattern of the pose graph, so one elimination serves both. In the plane a rotation is one complex number of
length 1: a Hermitian system of n numbers, which CHOLMOD factorizes four times faster than the 2n real ones.

Source: L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM", ICRA 2015.
"""

from __future__ import annotations

import numpy as np

from models import SE2, SE3
from models.algebra import Array, apply, product, wrap
from models.errors import UnderconstrainedError
from models.manifolds.so2 import rotation2
from models.manifolds.so3 import quaternion_from_matrix, rotation3
from nls.elimination import eliminated
from nls.graph import FactorGraph
from nls.hessian import Hessian
from nls.linear import best_factorization
from nls.linear.base import SingularSystemError
from nls.linear.normal import NormalState
from nls.starts.edges import PoseEdges, pose_edges
from nls.values import Values

__all__ = ["chordal"]

REGULAR = 1e-3  # det M above this, its largest entry being 1: Newton's iteration takes at most 15 steps
SETTLED = 1e-9  # a step of it after which the next one, its square, is below rounding
VANISHING = 1e-9  # a relaxed rotation this small beside its neighbors has lost its direction to contradicting ones


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
    system = _Laplacian(edges)
    if not len(system.free):
        return X
    free, kappa, tau = system.free, edges.weights(slice(d := edges.group.point_dim, None)), edges.weights(slice(0, d))
    if edges.group is SE2:  # y = exp(i theta): y_j = exp(i theta_ij) y_i
        T, start = np.exp(1j * edges.z[:, 2]), np.exp(1j * X[:, 2])
        y = system.solve(kappa, T[:, None, None], start[:, None, None])[:, 0, 0]
        angle, size = np.angle(y), np.abs(y)
        rotations = rotation2(angle)
    else:  # y = M', three columns: y_j = R_ij' y_i
        M = system.solve(kappa, rotation3(edges.z[:, 3:]).mT, edges.group.rotation(X).mT).mT
        rotations, size = nearest_rotation(M)
    # Noise makes relaxed rotations smaller with every edge from the held one, to 1e-15 on a sphere of a million edges,
    # and leaves their directions alone; a cancelled one is small among neighbors that are not.
    i, j = edges.i, edges.j
    around = np.bincount(i, kappa * size[j], edges.n) + np.bincount(j, kappa * size[i], edges.n)
    total = np.bincount(i, kappa, edges.n) + np.bincount(j, kappa, edges.n)
    if (size * total <= VANISHING * around)[free].any():
        raise UnderconstrainedError(
            "chordal relaxation: contradicting rotations cancel at a pose; start from 'odometry' or 'spanning-tree'"
        )
    difference = apply(rotations.take(edges.i, axis=0), edges.z[:, :d])
    position = system.solve(tau, np.ones((1, 1, 1)), X[:, None, :d], difference[:, None])[:, 0]

    out = np.array(X)
    out[free, :d] = position[free]
    out[free, d:] = wrap(angle)[free, None] if edges.group is SE2 else quaternion_from_matrix(rotations[free])
    return out


def nearest_rotation(M: Array) -> tuple[Array, Array]:
    """Rotation (n, 3, 3) nearest to each matrix, and a size (n,) that vanishes where it is not unique.

    Where det M is well above 0 it is the orthogonal factor of the polar decomposition, by Newton's iteration
    X <- (X + X^-T) / 2 on the whole stack (N. Higham, "Computing the polar decomposition", 1986): 1 ms for 2,500
    matrices, their singular value decomposition 10. Elsewhere U diag(1, 1, det UV') V', of which the second singular
    value is the size.
    """
    size = np.abs(M).max(axis=(-2, -1))  # may be 1e-150: its cube would be 0
    M = M / np.where(size > 0, size, 1.0)[:, None, None]
    X = np.ascontiguousarray(M.transpose(1, 2, 0))
    det = (X[0] * _cross(X[1], X[2])).sum(axis=0)
    regular = det > REGULAR
    out = np.empty_like(M)
    X = X[..., regular] / np.cbrt(det[regular])
    step = np.ones(1)
    while np.abs(step).max(initial=0.0) > SETTLED:
        C = np.stack([_cross(X[1], X[2]), _cross(X[2], X[0]), _cross(X[0], X[1])])  # det X times X^-T
        step = (C / (X[0] * C[0]).sum(axis=0) - X) / 2
        X += step
    out[regular] = X.transpose(2, 0, 1)
    if not regular.all():
        U, s, Vt = np.linalg.svd(M[~regular])
        U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
        out[~regular] = U @ Vt
        size[~regular] *= s[..., 1]
    return out, size


def _cross(a: Array, b: Array) -> Array:
    """Cross products (3, n) of vectors (3, n)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class _Laplacian:
    """Minimizers of sum w |y_j - T y_i - c|^2 over blocks y, T orthogonal, the first pose of each component held."""

    def __init__(self, edges: PoseEdges) -> None:
        free = edges.touched
        free[edges.roots()] = False
        self.edges, self.free = edges, np.flatnonzero(free)
        V = len(self.free)
        number = np.full(edges.n, V, dtype=np.intp)  # V: held
        number[self.free] = np.arange(V)
        self.i, self.j = number[edges.i], number[edges.j]
        self.both = np.flatnonzero((self.i < V) & (self.j < V))
        self.factorization = best_factorization()
        u, v = self.i[self.both], self.j[self.both]
        self.elimination = eliminated(u, v, V, self.factorization.order)  # of both systems
        self._hessians: dict[int, Hessian] = {}  # by size of the blocks: in the plane both systems have the same

    def solve(self, w: Array, T: Array, value: Array, c: Array | None = None) -> Array:
        """y (n, d, k) for weights w (m,), T (m or 1, d, d), c (m, d, k) or None for 0; held ones keep their value.

        T may be complex, of size 1: a rotation of the plane.
        """
        V, d = len(self.free), T.shape[-1]
        i, j, both = self.i, self.j, self.both
        T = np.broadcast_to(T, (len(w), d, d))
        T_t = T.conj().mT
        S = np.zeros((V + len(both), d, d), dtype=T.dtype)
        S[:V, range(d), range(d)] = (np.bincount(i, w, V + 1) + np.bincount(j, w, V + 1))[:V, None]
        off = T_t.take(both, axis=0)  # block (i, j)
        if np.iscomplexobj(T):  # of which H keeps the triangle below the diagonal
            off[self.elimination.turned] = T[both[self.elimination.turned]]
        np.multiply(off, -w[both, None, None], out=S[V:])
        if d not in self._hessians:
            begin = np.arange(len(S)) * d * d
            self._hessians[d] = Hessian(self.elimination, np.full(V, d), begin[:V], begin[V:])
        state = NormalState(self._hessians[d], self.factorization, S.dtype.type)

        # H y = g: what is known about y_j is T y_i + c with y_i held, and about y_i it is T'(y_j - c) with y_j held
        g = np.zeros((V + 1, d, value.shape[-1]), dtype=value.dtype)
        w_ = w[:, None, None]
        with np.errstate(over="ignore", invalid="ignore"):  # a start that is not finite is refused when it is evaluated
            from_i, from_j = np.flatnonzero(i == V), np.flatnonzero(j == V)
            np.add.at(g, j[from_i], w_[from_i] * product(T[from_i], value[self.edges.i[from_i]]))
            np.add.at(g, i[from_j], w_[from_j] * product(T_t[from_j], value[self.edges.j[from_j]]))
            if c is not None:
                to_j, to_i = w_ * c, w_ * product(T_t, c)
                for at in np.ndindex(g.shape[1:]):
                    g[:, *at] += np.bincount(j, to_j[:, *at], V + 1) - np.bincount(i, to_i[:, *at], V + 1)
        try:
            state.factorize(S.reshape(-1))
        except SingularSystemError as error:
            raise UnderconstrainedError(
                "chordal relaxation: some poses have no rotation or no translation measurement; start from 'odometry'"
            ) from error
        y = np.array(value)
        y[self.free] = state.solve(g[:V].reshape(V * d, -1)).reshape(V, d, -1)
        return y
