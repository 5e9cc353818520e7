r"""Chordal relaxation: all rotations from one linear system, then all translations from another.

Rotations minimize sum kappa |M_j - M_i R_ij|_F^2 over matrices M, without the constraint that they are rotations, and
are projected afterwards; translations then minimize sum tau |t_j - t_i - R_i t_ij|^2. Fixed poses keep their values;
in a component without any, the first pose does. kappa and tau are the mean informations of the two blocks. Both systems
have the pattern of the pose graph, so one elimination serves both. In the plane a rotation is one complex number of
length 1. CHOLMOD factorizes the Hermitian system of n numbers four times faster than the 2n real ones.

Source: L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM", ICRA 2015.
"""

from __future__ import annotations

import numpy as np

from models import SE2, SE3
from models.algebra import Array, apply, pack, product, wrap
from models.errors import UnderconstrainedError
from models.manifolds.se3 import join
from models.manifolds.so3 import quaternion_from_matrix, rotation3
from nls.graph import FactorGraph
from nls.linear.default import Laplacian
from nls.linear.factorization import SingularSystemError
from nls.posegraph import PoseGraph, pose_graphs
from nls.values import Values, refuse_other

ONE = np.ones((1, 1, 1))


def chordal(graph: FactorGraph, values: Values) -> Values:
    """Start of the poses of SE2 and SE3 by chordal relaxation; other variables stay.

    Parameters
    ----------
    graph : its relative poses are used, see `Factor.relative_poses`. Long levers of sensors make it poor.
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
    refuse_other("chordal", graph, values)
    for poses in pose_graphs(graph, values):
        if relaxed := {SE2: _plane, SE3: _space}.get(poses.group):
            system, X = _Relaxation(poses), poses.stack(values)
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused when it is evaluated
                out = relaxed(system, X[system.held]) if len(system.free) else X
            out[system.held] = X[system.held]
            values = poses.replaced(values, out)
    return values


def _plane(system: _Relaxation, held: Array) -> Array:
    """Poses (n, 3) from complex numbers: y_j = exp(i theta_ij) y_i, then p_j = p_i + y_i / |y_i| p_ij."""
    poses, z, held = system.poses, system.poses.z[..., None], held[..., None]  # blocks of 1 x 1
    kappa, tau = poses.mean_weights()
    y = system.minimizer(kappa, _turn(z[:, 2:]), 0.0, _turn(held[:, 2:]))
    size = np.abs(y)
    _refuse_cancelled(system, kappa, size[:, 0, 0])
    p_ij = (y * (1 / size)).take(poses.i, axis=0) * (z[:, :1] + 1j * z[:, 1:2])
    p = system.minimizer(tau, ONE, p_ij, held[:, :1] + 1j * held[:, 1:2])
    return pack([p.real, p.imag, wrap(np.arctan2(y.imag, y.real))])[:, 0, 0]


def _turn(theta: Array) -> Array:
    """exp(i theta), of which `numpy.exp` takes five times as long."""
    return np.asarray(np.cos(theta) + 1j * np.sin(theta))


def _space(system: _Relaxation, held: Array) -> Array:
    """Poses (n, 7) from y = M', three columns: y_j = R_ij' y_i, then t_j = t_i + R_i t_ij."""
    poses, z = system.poses, system.poses.z
    kappa, tau = poses.mean_weights()
    R, size = nearest_rotation(system.minimizer(kappa, rotation3(z[:, 3:]).mT, 0.0, rotation3(held[:, 3:]).mT).mT)
    _refuse_cancelled(system, kappa, size)
    t_ij = apply(R.take(poses.i, axis=0), z[:, :3])
    t = system.minimizer(tau, ONE, t_ij[:, None], held[:, None, :3])
    return join(t[:, 0], quaternion_from_matrix(R))


def _refuse_cancelled(system: _Relaxation, kappa: Array, size: Array) -> None:
    """Refuse rotations of a size (n,) that vanishes beside that of their neighbors.

    A relaxed rotation of a billionth beside its neighbors has lost its direction to contradicting ones.
    Noise makes relaxed rotations smaller with every edge from the held one, to 1e-15 on a sphere of a million edges,
    and leaves their directions alone; a cancelled one is small among neighbors that are not.
    """
    if size.min() > 1e-9 * size.max():
        return
    poses = system.poses
    around = poses.sums(kappa * size.take(poses.j), kappa * size.take(poses.i))
    if (size * poses.sums(kappa, kappa) <= 1e-9 * around).take(system.free).any():
        message = "contradicting rotations cancel at a pose; start from 'odometry' or 'spanning-tree'"
        raise UnderconstrainedError(f"chordal relaxation: {message}")


def nearest_rotation(M: Array) -> tuple[Array, Array]:
    """Rotation (n, 3, 3) nearest to each matrix, and a size (n,) that vanishes where it is not unique.

    Where det M is well above 0 it is the orthogonal factor of the polar decomposition, by Newton's iteration X <- (X +
    X^-T) / 2 on the whole stack. It takes 1 ms for 2,500 matrices, their singular value decomposition 10 (N. Higham,
    "Computing the polar decomposition", 1986). Elsewhere U diag(1, 1, det UV') V', of which the second singular value
    is the size.
    """
    size = np.abs(M).max(axis=(-2, -1))  # may be 1e-150: its cube would be 0
    M = M / np.where(size > 0, size, 1.0)[:, None, None]
    X = np.ascontiguousarray(M.transpose(1, 2, 0))
    det = (X[0] * _cofactors(X)[0]).sum(axis=0)
    regular = det > 1e-3  # the largest entry being 1: at most 15 steps
    out = np.empty_like(M)
    X = X[..., regular] / np.cbrt(det[regular])
    step = np.ones(1)
    while np.abs(step).max(initial=0.0) > 1e-9:  # the next step, its square, is below rounding
        C = _cofactors(X)
        step = (C / (X[0] * C[0]).sum(axis=0) - X) / 2
        X += step
    out[regular] = X.transpose(2, 0, 1)
    if not regular.all():
        U, s, Vt = np.linalg.svd(M[~regular])
        U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
        out[~regular] = U @ Vt
        size[~regular] *= s[..., 1]
    return out, size


def _cofactors(X: Array) -> Array:
    """det X times X^-T for (3, 3, n): C_rc = X_r+1,c+1 X_r+2,c+2 - X_r+1,c+2 X_r+2,c+1, places counted round."""
    Y = X.take((0, 1, 2, 0, 1), axis=0).take((0, 1, 2, 0, 1), axis=1)
    return np.asarray(Y[1:4, 1:4] * Y[2:, 2:] - Y[1:4, 2:] * Y[2:, 1:4])


class _Relaxation:
    """Minimizers of sums over edges of blocks y (n, d, k), real or complex, the first pose of each component held.

    With 0 for the free ones the edges miss by e = T y_i + c - y_j, and H y = g: w e at j and -w T'e at i, summed.
    """

    def __init__(self, poses: PoseGraph) -> None:
        free = poses.touched.copy()
        free[poses.roots] = False
        self.poses, self.free, self.held = poses, free.nonzero()[0], (~free).nonzero()[0]
        self.free_edges = (free.take(poses.i) & free.take(poses.j)).nonzero()[0]
        number = np.cumsum(free) - 1
        u, v = number.take(poses.i.take(self.free_edges)), number.take(poses.j.take(self.free_edges))
        self.laplacian = Laplacian(u, v, len(self.free), poses.pattern)  # of both systems

    def minimizer(self, w: Array, T: Array, c: Array | float, held: Array) -> Array:
        """Of sum w |y_j - T y_i - c|^2, w (m,), T (m or 1, d, d) orthogonal, c (m, d, k), that keeps held (h, d, k)."""
        poses, V, (d, k) = self.poses, len(self.free), held.shape[1:]
        y, g = np.zeros((2, poses.n, d, k), dtype=held.dtype)
        y[self.held] = held
        wT_t = w[:, None, None] * T.mT.conj()
        e = product(T, y.take(poses.i, axis=0)) + c - y.take(poses.j, axis=0)
        numbers = np.arange(d * k)
        np.add.at(g.reshape(-1), (poses.j[:, None] * (d * k) + numbers).reshape(-1), (w[:, None, None] * e).reshape(-1))
        np.subtract.at(g.reshape(-1), (poses.i[:, None] * (d * k) + numbers).reshape(-1), product(wT_t, e).reshape(-1))
        on_diagonal = poses.sums(w, w).take(self.free)[:, None, None] * np.eye(d, dtype=y.dtype)
        try:
            state = self.laplacian.factorized(on_diagonal, -wT_t[self.free_edges])
        except SingularSystemError as error:
            unmeasured = "some poses have no rotation or no translation measurement"
            cause = "weights of edges differ too much" if (w > 0).all() else unmeasured
            raise UnderconstrainedError(f"chordal relaxation: {cause}; start from 'odometry'") from error
        y[self.free] = state.solve(g[self.free].reshape(V * d, k)).reshape(V, d, k)
        return y
