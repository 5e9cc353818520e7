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

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from factors.base import Model
from factors.between import Between
from factors.prior import Prior
from models import SE2, SE3, LieGroup
from models.algebra import Array, gram, pack
from models.errors import GraphError
from models.manifolds.se3 import join
from models.manifolds.so3 import quaternion_from_matrix
from nls.graph import FactorGraph
from nls.linear import best_decomposition
from nls.linear.factorization import Factorization
from nls.sparse.components import connected
from nls.sparse.elimination import Elimination
from nls.sparse.hessian import Hessian
from nls.starts.edges import PoseEdges, pose_edges
from nls.values import Values

__all__ = ["PoseGraph", "certifiable"]


class PoseGraph:
    """A pose graph in the certifiable cost.

    Parameters
    ----------
    edges : the measurements between n poses, all connected.
    kappa, tau : (m,) weights of rotations and translations.
    held : the pose that keeps its place.

    Attributes
    ----------
    d, n : 2 or 3, and the number of poses.
    T, W : (m, d + 1, d + 1) and (m, d + 1).
    on_diagonal, off : Q_ii (n, d + 1, d + 1) and Q_ij (m, d + 1, d + 1).
    """

    def __init__(self, edges: PoseEdges, kappa: Array, tau: Array, held: int) -> None:
        self.edges, self.n, self.d, self.held = edges, edges.n, edges.group.point_dim, held
        m, d = len(edges.i), self.d
        self.T = np.zeros((m, d + 1, d + 1))
        self.T[:, :d, :d], self.T[:, :d, d] = edges.group.rotation(edges.z), edges.group.position(edges.z)
        self.T[:, d, d] = 1.0
        self.W = np.column_stack([np.repeat(kappa[:, None], d, axis=1), tau])
        edge, one = np.arange(m), np.ones(m)
        self._at_i, self._at_j = (sp.csr_array((one, (node, edge)), shape=(self.n, m)) for node in (edges.i, edges.j))
        TW = self.T * self.W[:, None]
        self.on_diagonal = self._summed(TW @ self.T.mT, self.W[:, None] * np.eye(d + 1))
        self.off = -TW
        self._factorizations: dict[int, Factorization] = {}

    def _summed(self, at_i: Array, at_j: Array) -> Array:
        """Sums (n, ...) at every pose of what its edges (m, ...) have there."""
        m, *shape = at_i.shape
        out = self._at_i @ at_i.reshape(m, -1) + self._at_j @ at_j.reshape(m, -1)
        return np.asarray(out.reshape(self.n, *shape))

    def matrices(self, X: Array) -> Array:
        """M (n, d + 1, d) of poses (n, size)."""
        group = self.edges.group
        return np.concatenate([group.rotation(X).mT, group.position(X)[:, None]], axis=1)

    def poses(self, M: Array) -> Array:
        """Poses (n, size) of M (n, d + 1, d) whose Y are rotations."""
        R, p = M[:, : self.d].mT, M[:, self.d]
        if self.d == 3:
            return join(p, quaternion_from_matrix(R))
        return pack([*p.T, np.arctan2(R[:, 1, 0], R[:, 0, 0])])

    def _residuals(self, M: Array) -> Array:
        return np.asarray(M[self.edges.j] - self.T.mT @ M[self.edges.i])

    def cost(self, M: Array) -> float:
        """tr M Q M', from the residuals, so that nothing cancels."""
        return float(np.sum(self.W[..., None] * np.square(self._residuals(M))))

    def rounding(self, M: Array) -> float:
        """The cost of residuals that are rounding alone."""
        size = np.square(M[self.edges.i]).sum(axis=2) + np.square(M[self.edges.j]).sum(axis=2)
        return float(np.sum(self.W * size) * np.square(8 * np.finfo(float).eps))

    def product(self, M: Array) -> Array:
        """Q M' (n, d + 1, r), half the gradient."""
        We = self.W[..., None] * self._residuals(M)
        return self._summed(-self.T @ We, We)

    def multipliers(self, M: Array, QM: Array) -> Array:
        """Lambda_i = sym((Q M')_i Y_i) of the rotation rows, with zeros for the position (n, d + 1, d + 1)."""
        L = np.zeros_like(self.on_diagonal)
        product = QM[:, : self.d] @ M[:, : self.d].mT
        L[:, : self.d, : self.d] = (product + product.mT) / 2
        return L

    def factorized(self, on_diagonal: Array, off: Array) -> Factorization:
        """Cholesky factorization of the symmetric matrix of blocks (n, k, k), and (m, k, k) of the edges.

        Raises
        ------
        SingularSystemError
            It is not positive definite.
        """
        k = off.shape[-1]
        if k not in self._factorizations:
            begin = np.arange(self.n + len(off)) * k * k
            hessian = Hessian(self._elimination, np.full(self.n, k), begin[: self.n], begin[self.n :])
            self._factorizations[k] = Factorization(hessian, best_decomposition()(hessian))
        return self._factorizations[k].factorize(np.concatenate([on_diagonal.reshape(-1), off.reshape(-1)]))

    @cached_property
    def _elimination(self) -> Elimination:
        """The order of the poses, whatever the sizes of their blocks."""
        return Elimination(self.edges.i, self.edges.j, self.n, best_decomposition().order)


def certifiable(graph: FactorGraph, values: Values) -> PoseGraph:
    """The pose graph of a factor graph.

    Raises
    ------
    GraphError
        The graph is not one pose graph: other measurements, robust kernels, several parts or spaces, more than one pose
        that something else holds; or information that has no inverse.
    """
    anchors = _anchors(graph)
    found = list(pose_edges(graph, values))
    if len(found) != 1 or found[0].group not in (SE2, SE3):
        spaces = ", ".join(str(edges.group) for edges in found) or "nothing"
        raise GraphError(f"certify: Between factors of {spaces}; expected those of one pose graph, of SE2 or of SE3")
    edges = found[0]
    numbers = {kind: values.stack(kind).numbers for kind in edges.kinds}
    nodes = [f"{kind}{number}" for kind in edges.kinds for number in numbers[kind]]
    first = int(edges.order[0])
    part = connected(edges.i, edges.j, edges.n)
    if (apart := part != part[first]).any():
        raise GraphError(
            f"certify: {nodes[int(np.argmax(apart))]} and {nodes[first]} are not connected; expected one connected "
            "pose graph: certify its parts one by one"
        )
    held = sorted({*(nodes[k] for k in np.flatnonzero(edges.fixed)), *anchors})
    if len(held) > 1:
        raise GraphError(
            f"certify: {held[0]} and {held[1]} are both held in the world, by a Prior or fixed; expected one pose at "
            "most: what else says where poses are is not in the cost that can be certified"
        )
    if anchors and anchors[0] not in nodes:
        raise GraphError(f"certify: Prior({anchors[0]}) is on no pose of the graph; remove it")
    weights = [_weights(model, edges.group) for model in edges.models]
    kappa, tau = (np.concatenate(parts) for parts in zip(*weights, strict=True))
    return PoseGraph(edges, kappa, tau, nodes.index(held[0]) if held else first)


def _anchors(graph: FactorGraph) -> list[str]:
    """The variables that a `Prior` is on; everything but `Between` and `Prior` is refused."""
    anchors = []
    for factor in graph.factors:
        if not len(factor):
            continue
        if isinstance(factor, Prior):
            anchors += [repr(factor.keys[0][[k]]) for k in range(len(factor))][:2]
        elif not isinstance(factor, Between):
            raise GraphError(
                f"certify: {factor!r:.80} is no measured difference of two poses; expected Between factors alone",
                factor.keys,
                factor.name,
            )
        elif factor.kernel is not None:
            raise GraphError(
                f"certify: {factor!r:.80} has the robust kernel {factor.kernel!r}; certify the graph without kernels, "
                "and without the measurements that they would turn off",
                factor.keys,
                factor.name,
            )
    return anchors


def _weights(model: Model, group: LieGroup) -> tuple[Array, Array]:
    """kappa and tau (m,) from the information of every measurement."""
    d, n = group.point_dim, len(model.z)
    W = np.broadcast_to(
        model.W if model.W.ndim == 3 else model.W[..., None] * np.eye(group.dim), (n, *2 * (group.dim,))
    )
    I = gram(W)
    blocks = {"position": I[:, :d, :d], "rotation": I[:, d:, d:]}
    trace = {}
    for what, block in blocks.items():
        weak = ~(np.linalg.eigvalsh(block)[:, 0] > SINGULAR * np.trace(block, axis1=1, axis2=2))
        if weak.any():
            name = model.factor.describe(int(np.argmax(weak)))
            raise GraphError(
                f"certify: {name} has no information about a direction of its {what}; expected one that has an inverse",
                model.factor.keys,
                model.factor.name,
            )
        trace[what] = np.trace(np.linalg.inv(block), axis1=1, axis2=2)
    return I[:, 2, 2] if d == 2 else 1.5 / trace["rotation"], d / trace["position"]


SINGULAR = 1e-12  # smallest eigenvalue of an information block beside its trace
