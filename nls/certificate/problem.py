r"""The cost of a pose graph whose optimum can be certified, and the sparse matrices that belong to it.

A pose is the matrix M = [Y p] of r rows and d + 1 columns, Y'Y = I: for r = d a rotation and a position, for r > d the
same with more room to turn. With T_ij = [[R_ij, t_ij], [0, 1]] and W_ij = diag(kappa, .., kappa, tau) an edge costs

    tr (M_j - M_i T) W (M_j - M_i T)' = kappa |Y_j - Y_i R_ij|_F^2 + tau |p_j - p_i - Y_i t_ij|^2

which is quadratic in M: all edges together tr M Q M', Q sparse with the blocks

    Q_jj += W,    Q_ii += T W T',    Q_ij += -T W

In the code `M` holds the transposed matrices M_i' as (n, d + 1, r), so that the product with Q is one of stacks.

Source: D. Rosen, L. Carlone, A. Bandeira, J. Leonard, "SE-Sync: a certifiably correct algorithm for synchronization
over the special Euclidean group", IJRR 38(2-3), 2019.
"""

import numpy as np

from factors.between import Between
from factors.prior import Prior
from models import SE2, SE3
from models.algebra import Array, pack
from models.errors import GraphError
from models.manifolds.se3 import join
from models.manifolds.so3 import quaternion_from_matrix
from nls.graph import FactorGraph
from nls.linear.default import Laplacian
from nls.linear.factorization import Factorization
from nls.posegraph import PoseGraph, pose_graphs
from nls.values import Values


class Problem:
    """The certifiable cost of a pose graph.

    Parameters
    ----------
    graph : the measurements between n poses, all connected.
    held : the pose that keeps its place.

    Attributes
    ----------
    d, n : 2 or 3, and the number of poses.
    T, W : (m, d + 1, d + 1) and (m, d + 1).
    on_diagonal, off : Q_ii (n, d + 1, d + 1) and Q_ij (m, d + 1, d + 1).

    Raises
    ------
    GraphError
        Information that has no inverse.
    """

    def __init__(self, graph: PoseGraph, held: int) -> None:
        self.graph, self.n, self.d, self.held = graph, graph.n, graph.group.point_dim, held
        m, d, (kappa, tau) = len(graph.i), self.d, _weights(graph)
        self.T = np.zeros((m, d + 1, d + 1))
        self.T[:, :d, :d], self.T[:, :d, d] = graph.group.rotation(graph.z), graph.group.position(graph.z)
        self.T[:, d, d] = 1.0
        self.W = np.column_stack([np.repeat(kappa[:, None], d, axis=1), tau])
        TW = self.T * self.W[:, None]
        self.on_diagonal = graph.sums(TW @ self.T.mT, self.W[:, None] * np.eye(d + 1))
        self.off = -TW
        self._laplacian = Laplacian(graph.i, graph.j, graph.n, graph.pattern)

    def matrices(self, X: Array) -> Array:
        """M (n, d + 1, d) of poses (n, size)."""
        group = self.graph.group
        return np.concatenate([group.rotation(X).mT, group.position(X)[:, None]], axis=1)

    def poses(self, M: Array) -> Array:
        """Poses (n, size) of M (n, d + 1, d) whose Y are rotations."""
        R, p = M[:, : self.d].mT, M[:, self.d]
        if self.d == 3:
            return join(p, quaternion_from_matrix(R))
        return pack([*p.T, np.arctan2(R[:, 1, 0], R[:, 0, 0])])

    def _residuals(self, M: Array) -> Array:
        return np.asarray(M[self.graph.j] - self.T.mT @ M[self.graph.i])

    def cost(self, M: Array) -> float:
        """tr M Q M', from the residuals, so that nothing cancels."""
        return float(np.sum(self.W[..., None] * np.square(self._residuals(M))))

    def rounding(self, M: Array) -> float:
        """The cost of residuals that are rounding alone."""
        size = np.square(M[self.graph.i]).sum(axis=2) + np.square(M[self.graph.j]).sum(axis=2)
        return float(np.sum(self.W * size) * np.square(8 * np.finfo(float).eps))

    def product(self, M: Array) -> Array:
        """Q M' (n, d + 1, r), half the gradient."""
        We = self.W[..., None] * self._residuals(M)
        return self.graph.sums(-self.T @ We, We)

    def multipliers(self, M: Array, QM: Array) -> Array:
        """Lambda_i = sym((Q M')_i Y_i) of the rotation rows, with zeros for the position (n, d + 1, d + 1)."""
        L = np.zeros_like(self.on_diagonal)
        product = QM[:, : self.d] @ M[:, : self.d].mT
        L[:, : self.d, : self.d] = (product + product.mT) / 2
        return L

    def factorized(self, on_diagonal: Array, off: Array) -> Factorization:
        """`Laplacian.factorized` with blocks (n, k, k), and (m, k, k) of the edges."""
        return self._laplacian.factorized(on_diagonal, off)


def certifiable(graph: FactorGraph, values: Values) -> Problem:
    """The certifiable cost of a factor graph.

    Raises
    ------
    GraphError
        The graph is not one pose graph: other measurements, robust kernels, several parts or spaces, more than one pose
        that something else holds; or information that has no inverse.
    """
    _refuse_others(graph)
    graphs = pose_graphs(graph, values)
    if len(graphs) != 1 or graphs[0].group not in (SE2, SE3):
        spaces = ", ".join(str(poses.group) for poses in graphs) or "nothing"
        raise GraphError(f"certify: Between factors of {spaces}; expected those of one pose graph, of SE2 or of SE3")
    poses, first = graphs[0], int(graphs[0].order[0])
    if (apart := (label := poses.component) != label[first]).any():
        name, of = (repr(poses.pattern.key(int(poses.variables[node]))) for node in (np.argmax(apart), first))
        expected = "expected one connected pose graph: certify its parts one by one"
        raise GraphError(f"certify: {name} and {of} are not connected; {expected}")
    anchors = [batch.variables[0] for batch in poses.pattern.batches if isinstance(batch.model.factor, Prior)]
    held = np.unique(np.concatenate([poses.variables[poses.fixed], *anchors]))
    if len(held) > 1:
        names = sorted(repr(poses.pattern.key(int(variable))) for variable in held)
        raise GraphError(
            f"certify: {names[0]} and {names[1]} are both anchored, by a Prior or fixed; expected one pose at most: "
            "the certified cost has relative measurements alone"
        )
    if len(held) and held[0] not in poses.variables:
        raise GraphError(f"certify: Prior({poses.pattern.key(int(held[0]))!r}) is on no pose of the graph; remove it")
    return Problem(poses, int(poses.nodes(held)[0]) if len(held) else first)


def _refuse_others(graph: FactorGraph) -> None:
    """Refuse measurements other than `Between` and `Prior`, and robust kernels."""
    for factor in graph.factors:
        if not len(factor) or isinstance(factor, Prior):
            continue
        if not isinstance(factor, Between):
            fault = "is no measured difference of two poses; expected Between factors alone"
        elif factor.kernel is not None:
            fault = (
                f"has the robust kernel {factor.kernel!r}; certify the graph without kernels, and without the "
                "measurements that they would turn off"
            )
        else:
            continue
        raise GraphError(f"certify: {factor!r:.80} {fault}", factor.keys, factor.name)


def _weights(poses: PoseGraph) -> tuple[Array, Array]:
    """kappa and tau (m,) of a pose graph, none of them 0."""
    kappa, tau = poses.isotropic_weights()
    for batch, kappa_b, tau_b in zip(poses.batches, poses.by_batch(kappa), poses.by_batch(tau), strict=True):
        for space, weights in (("position", tau_b), ("rotation", kappa_b)):
            if not weights.all():
                factor = batch.model.factor
                raise GraphError(
                    f"certify: {factor.describe(int(np.argmin(weights)))} has no information about a direction of its "
                    f"{space}; expected one that has an inverse",
                    factor.keys,
                    factor.name,
                )
    return kappa, tau
