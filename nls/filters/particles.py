r"""A cloud of weighted elements of a manifold: mean, covariance, and drawing anew; the landmarks of all particles.

    mean         sum_k w_k local(mean, X_k) = 0            headings on the circle, whatever side of +-pi they are on
    covariance   sum_k w_k e_k e_k',  e_k = local(mean, X_k)
    effective    1 / sum w_k^2

Per particle and landmark there is a mean l and a covariance C, updated all at once. With whitened Jacobians A_l and
innovations b of a factor (unit noise), pose by pose as exact as the particle says:

    S = I + A_l C A_l',   K = C A_l' S^-1
    l <- l [+] K b,       C <- (I - K A_l) C (I - K A_l)' + K K'
    log N(b; 0, S) = -(b' S^-1 b + log det S) / 2                       what the sighting is worth, up to a constant
    first seen:           l = locate(X, z),   C = (A_l' A_l)^-1

Sources: R. Hartley et al., "Rotation averaging", IJCV 2013, section 5 (the mean); G. Kitagawa, "Monte Carlo filter and
smoother for non-Gaussian nonlinear state space models", 1996 (systematic resampling); S. Thrun, W. Burgard, D. Fox,
Probabilistic Robotics, 2005, table 4.4 and section 13.3.
"""

import numpy as np

from factors import Factor, Sighting
from factors.keys import Keys
from models import LieGroup, Manifold
from models.algebra import Array, Index, apply, gram, product
from models.errors import GraphError
from nls.filters.map_state import rows_of
from nls.filters.motion import Copies, copies, most_likely


def normalized_weights(log_w: Array) -> Array:
    """Weights (N,) that add up to 1, from their logarithms up to a constant.

    Examples
    --------
    >>> normalized_weights(np.array([-2000.0, -2000.0, -np.inf]))
    array([0.5, 0.5, 0. ])
    """
    w = np.exp(log_w - log_w.max())
    return np.asarray(w / w.sum())


def effective(w: Array) -> float:
    """How many equal weights say as much as these do, 1 to N.

    Examples
    --------
    >>> effective(np.array([0.5, 0.5, 0.0]))
    2.0
    """
    return float(1 / np.square(w).sum())


def systematic(w: Array, rng: np.random.Generator) -> Index:
    """Which particle each new one descends from, (N,): weight k has N w_k descendants, rounded up or down.

    Examples
    --------
    >>> systematic(np.array([0.5, 0.0, 0.25, 0.25]), np.random.default_rng(1))
    array([0, 0, 2, 3])
    """
    N = len(w)
    below = np.cumsum(w)
    below[-1] = 1.0  # rounding must leave nobody above the last
    return np.searchsorted(below, (rng.random() + np.arange(N)) / N, side="right")


def mean(manifold: Manifold, X: Array, w: Array) -> Array:
    """Weighted mean (m, size) of clouds X (N, m, size) with weights w (N,).

    Examples
    --------
    >>> from models import SE2
    >>> mean(SE2, np.array([[[0.0, 0.0, 3.0]], [[2.0, 0.0, -3.0]]]), np.array([0.5, 0.5]))[0, 2] + np.pi
    np.float64(0.0)
    """
    center: Array = X[int(np.argmax(w))].copy()
    for _ in range(30):  # 3 to 5 unless the elements are spread around the circle
        step = np.einsum("n,nmd->md", w, manifold.local(np.broadcast_to(center, X.shape), X))
        center = manifold.retract(center, step)
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    return center


def covariance(manifold: Manifold, center: Array, X: Array, w: Array) -> Array:
    """Weighted second moment (m, d, d) about the center (m, size), in the tangent space there."""
    e = manifold.local(np.broadcast_to(center, X.shape), X)
    return np.asarray(np.einsum("n,nmi,nmj->mij", w, e, e))


class ParticleMap:
    """Landmarks of one kind, m of them for each of N particles.

    Attributes
    ----------
    numbers : (m,) of the landmarks, in the order they were found.
    L, C : (N, m, size) means and (N, m, d, d) covariances, particle by particle.
    """

    def __init__(self, kind: str, manifold: Manifold, particles: int) -> None:
        self.kind, self.manifold, self.particles = kind, manifold, particles
        self.numbers = np.zeros(0, dtype=np.int64)
        self.L = np.zeros((particles, 0, manifold.size))
        self.C = np.zeros((particles, 0, manifold.dim, manifold.dim))

    def rows(self, keys: Keys) -> Index:
        """Places of landmarks (n,), -1 where one is not known."""
        return rows_of(keys.numbers, self.numbers)

    def known(self, factor: Factor) -> tuple[Factor | None, Factor | None]:
        """The measurements of landmarks that are known, and the others; None where there are none."""
        known = self.rows(factor.keys[-1]) >= 0
        if known.all():
            return factor, None
        return factor[np.flatnonzero(known)] if known.any() else None, factor[np.flatnonzero(~known)]

    def innovation(self, many: Copies, *X: Array) -> tuple[Array, Array, Array]:
        """A (N n, k, ...) for the pose and the landmark side by side, b (N n, k) and S; X the poses, if it has any."""
        rows = self.rows(many.factor.keys[-1][: many.n])
        A, b = many.linearize(*X, self.L[:, rows])
        C = self.C[:, rows].reshape(-1, *self.C.shape[2:])
        return np.concatenate(A, axis=2), b, np.eye(b.shape[1]) + product(product(A[-1], C), A[-1].mT)

    def update(self, many: Copies, *X: Array) -> Array:
        """A Kalman update by measurements of different known landmarks; returns log N(b; 0, S) (N,)."""
        rows, d = self.rows(many.factor.keys[-1][: many.n]), self.manifold.dim
        A, b, S = self.innovation(many, *X)
        A_l, C = A[:, :, -d:], self.C[:, rows].reshape(-1, d, d)
        S_inv = np.asarray(np.linalg.inv(S), dtype=float)
        K = product(product(C, A_l.mT), S_inv)
        I_KA = np.eye(d) - product(K, A_l)
        L = self.manifold.retract(self.L[:, rows].reshape(len(C), -1), apply(K, b))
        self.L[:, rows] = L.reshape(self.particles, len(rows), -1)
        C = product(product(I_KA, C), I_KA.mT) + product(K, K.mT)
        self.C[:, rows] = C.reshape(self.particles, len(rows), d, d)
        log_N = -(np.einsum("ni,nij,nj->n", b, S_inv, b) + np.linalg.slogdet(S)[1]) / 2
        return np.asarray(log_N.reshape(self.particles, -1).sum(axis=1))

    def start(self, factor: Factor, group: Manifold, X: Array) -> None:
        """Put new landmarks where each particle sees them from its pose X (N, size).

        Raises
        ------
        GraphError
            One such measurement does not say where its landmark is.
        """
        if not isinstance(factor, Sighting) or not factor.locates:
            message = f"{factor.describe(0)} is the first to observe {factor.keys[1][[0]]}, and does not"
            cure = "give a Prior of the landmark, or measure bearing and range together"
            raise GraphError(f"{message} determine its position: {cure}", factor.keys, factor.name)
        many = copies(factor, [group, self.manifold], self.particles)
        assert isinstance(group, LieGroup)
        assert isinstance(many.factor, Sighting)
        (X_each,) = many.stacked(X)
        L = many.factor.locate(group, many.factor.sensor_pose(group, X_each), many.model.z)
        (_, A_l), _ = many.model.linearize(X_each, L)
        C = np.asarray(np.linalg.inv(gram(A_l)), dtype=float)
        self.add(factor.keys[1], L.reshape(self.particles, len(factor), -1), C)

    def start_alone(self, factor: Factor, at: Array) -> None:
        """Put new landmarks where measurements of them alone have them, from start values at (n, size)."""
        for k, key in enumerate(factor.keys[0]):  # one landmark each: of a chart, once
            single: Copies = copies(factor[[k]], [self.manifold], 1)
            L, Lambda = most_likely([(single, 0, ())], self.manifold, at[[k]], key)
            shape = (self.particles, 1, 1)
            self.add(key, np.tile(L, shape), np.tile(np.linalg.inv(Lambda), (*shape, 1)))

    def add(self, keys: Keys, L: Array, C: Array) -> None:
        """New landmarks, L (N, n, size) and C (N, n, d, d), whose first axes may be one."""
        d = self.manifold.dim
        self.numbers = np.concatenate([self.numbers, keys.numbers])
        self.L = np.concatenate([self.L, L], axis=1)
        self.C = np.concatenate([self.C, C.reshape(self.particles, len(keys), d, d)], axis=1)

    def resample(self, parents: Index) -> None:
        """Every particle takes the landmarks of its parent."""
        self.L, self.C = self.L[parents], self.C[parents]

    def estimate(self, w: Array) -> tuple[Keys, Array, Array]:
        """Keys, means (m, size) and covariances (m, d, d) over all particles, with their weights w (N,).

        A covariance is the mean of those of the particles and the spread of their means.
        """
        center = mean(self.manifold, self.L, w)
        P = covariance(self.manifold, center, self.L, w) + np.einsum("n,nmij->mij", w, self.C)
        return Keys(self.kind, self.numbers), center, P


def each_once(factor: Factor) -> list[Factor]:
    """Parts of a batch in which no landmark comes twice, in order; nearly always the batch itself."""
    numbers = factor.keys[-1].numbers
    earlier = np.tril(numbers[:, None] == numbers, -1).sum(axis=1)
    rounds = range(int(earlier.max(initial=0)) + 1)
    return [factor[np.flatnonzero(earlier == k)] for k in rounds] if len(rounds) > 1 else [factor]
