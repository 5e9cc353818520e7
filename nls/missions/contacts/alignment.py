r"""Where one local map lies on another: the motion that brings most of their landmarks together.

Landmark i of map a and landmark j of map b are in the frame of the anchor of b. After a motion delta of that anchor
they differ by r_ij, and J_j is its Jacobian:

    r_ij = Exp(delta) p_j - p_i,    J_j = [I, -[p_j]x],    d^2_ij = r_ij' (C_i + C_j)^-1 r_ij

delta has the covariance Sigma = S S' by all that is known. A grid of turns, and the shift that most pairs vote for,
give motions to begin with. Least squares over matches moves each of them, and the one with most matches is best. A
match is a pair within the gate, of two landmarks that are nearest to each other.

Dense maps match by chance, wherever they lie. So the maps are shifted a little way off, and matched again. An alignment
is sure where it has many more matches than any of these.

Sources: E. Olson, "Real-time correlative scan matching", ICRA 2009, for the search by votes; J. Neira, J. D. Tardos,
"Data association in stochastic mapping using the joint compatibility test", IEEE Transactions on Robotics and
Automation 17, 2001, for matches that are right together.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from models import LieGroup
from models.algebra import Array, Index, apply, product
from models.chi_squared import mahalanobis
from models.sensors import point_in_frame
from nls.missions.contacts import partition
from nls.missions.contacts.estimate import KERNEL, quadratic

LEAST_MATCHES = 10
MOST_MOTIONS = 500_000  # pairs times turns; a motion that is known so poorly waits for that of other maps
WIDE_GATE = 4.0  # times the gate, for the first matches


class Points(NamedTuple):
    """Landmarks p (k, d) of a map in one frame, m, and the covariance C (k, d, d) of each beside its anchor, m^2."""

    p: Array
    C: Array


@dataclass(frozen=True)
class Alignment:
    """A motion of map b, on the right of its anchor.

    Attributes
    ----------
    delta : (d,) the motion.
    chance : the most landmarks that match after a shift.
    i, j, d2 : (k,) landmarks of a and of b that match, and their squared distance.
    """

    delta: Array
    chance: int
    i: Index
    j: Index
    d2: Array

    @property
    def sure(self) -> bool:
        """Whether no shift matches nearly as many: by chance they scatter with their square root."""
        return len(self.i) >= LEAST_MATCHES and len(self.i) > self.chance + 4.0 * sqrt(self.chance)


def aligned(group: LieGroup, a: Points, b: Points, Sigma: Array, gate: float) -> Alignment | None:
    """The alignment of map b with map a; None where too few landmarks may match, or the motion is known too poorly.

    Parameters
    ----------
    group : of the motion.
    a, b : landmarks of both, in the frame of the anchor of b.
    Sigma : (m, m) covariance of the motion.
    gate : bound on d^2.
    """
    if min(len(a.p), len(b.p)) < LEAST_MATCHES:
        return None
    maps, (w, V) = _Maps(group, a, b, gate), np.linalg.eigh(Sigma)
    S = V * np.sqrt(np.maximum(w, 0.0))
    starts = maps.starts(Sigma)
    if not len(starts):
        return None
    fits, n = maps.fitted(starts, S)
    if n.max() < LEAST_MATCHES:
        return None
    best, middle = fits[n.argmax()], maps.J.mean(axis=0)
    _, i, j, _, _, d2 = maps.matches(best[None], gate)

    def with_chance(alignment: Alignment, fits: Array, n: Index) -> Alignment:
        elsewhere = np.linalg.norm((fits - best) @ middle.T, axis=1) > 2 * maps.cell
        return replace(alignment, chance=max(alignment.chance, int(n[elsewhere].max(initial=0))))

    alignment = with_chance(Alignment(best, 0, i, j, d2), fits, n)
    return with_chance(alignment, *maps.fitted(best + maps.shifts(), S)) if alignment.sure else alignment


@dataclass(frozen=True)
class _Maps:
    """Maps a and b in one frame, the group of its motions, and the gate."""

    group: LieGroup
    a: Points
    b: Points
    gate: float

    @cached_property
    def J(self) -> Array:
        """Jacobians (k, d, m) of the landmarks of b by a motion."""
        return np.asarray(-point_in_frame(self.group, self.group.identity(len(self.b.p)), self.b.p)[1][0])

    @cached_property
    def tree(self) -> Any:
        """Of the landmarks of a."""
        from scipy.spatial import cKDTree

        return cKDTree(self.a.p)

    @cached_property
    def cell(self) -> float:
        """Two sigmas of the distance of two landmarks, along one axis, m."""
        variance = sum(float(np.median(np.trace(C, axis1=1, axis2=2))) for _, C in (self.a, self.b))
        return 2 * sqrt(variance / len(self.J[0]))

    def matches(self, delta: Array, bound: float) -> tuple[Index, Index, Index, Array, Array, Array]:
        """The matches after motions (q, m): which of these (n,), landmarks i (n,) of a and j (n,) of b.

        Each is the nearest of the other, with d^2 below a bound. And r (n, d), its information (n, d, d), and d^2 (n,).
        """
        k = len(self.b.p)
        moved = self.group.act(self.group.exp(delta).repeat(k, axis=0), np.tile(self.b.p, (len(delta), 1)))
        bound_m = sqrt(WIDE_GATE * self.gate) * self.cell
        distance, near = self.tree.query(moved, 8, distance_upper_bound=bound_m)
        row, column = np.nonzero(np.isfinite(distance))
        (which, j), i = np.divmod(row, k), near[row, column]
        r, W = moved[row] - self.a.p[i], np.linalg.inv(self.a.C[i] + self.b.C[j])
        d2 = quadratic(r, W)
        match = (d2 < bound) & partition.largest(which * len(self.a.p) + i, -d2) & partition.largest(row, -d2)
        return which[match], i[match], j[match], r[match], W[match], d2[match]

    def fitted(self, start: Array, S: Array) -> tuple[Array, Index]:
        """The motions (q, m) near starts (q, m) whose matches fit best, and how many these are (q,).

        S S' is the covariance of the motion about each start.
        """
        delta, which = start, np.zeros(0, dtype=np.intp)
        for bound in (WIDE_GATE * self.gate, WIDE_GATE * self.gate, self.gate, self.gate, self.gate):
            which, _, j, r, W, d2 = self.matches(delta, bound)
            J, Omega, pull = self.J[j], np.zeros((len(start), *S.shape)), np.zeros(start.shape)
            WJ = KERNEL.weight(d2)[:, None, None] * product(W, J)
            r = r - apply(J, (delta - start)[which])
            np.add.at(Omega, which, product(J.mT, WJ))
            np.add.at(pull, which, apply(WJ.mT, r))
            delta = start - np.linalg.solve(S.T @ Omega @ S + np.eye(len(S)), (pull @ S)[..., None])[..., 0] @ S.T
        return delta, np.bincount(which, minlength=len(start))

    def starts(self, Sigma: Array) -> Array:
        """Six motions (q, m) to begin with: turns, with the shifts most pairs vote for; none where that is much."""
        a, b, J, k = self.a, self.b, self.J, self.a.p.shape[1]
        extent = float(np.linalg.norm(b.p - b.p.mean(axis=0), axis=1).max())
        turns = _turns(Sigma[k:, k:], self.cell / max(extent, self.cell))
        spread = J @ Sigma @ J.mT
        reach = sqrt(self.gate) * (sqrt(float(np.linalg.eigvalsh(spread)[:, -1].max())) + self.cell)
        other = type(self.tree)(b.p)
        none = np.zeros((0, len(Sigma)))
        if not len(turns) or self.tree.count_neighbors(other, reach) * len(turns) > MOST_MOTIONS:
            return none
        pairs = self.tree.sparse_distance_matrix(other, reach, output_type="ndarray")
        i, j = pairs["i"], pairs["j"]
        e = b.p[j] - a.p[i]
        possible = mahalanobis(e, spread[j] + a.C[i] + b.C[j]) < self.gate
        e, J = e[possible], J[j[possible]]
        gain = Sigma[:k, k:] @ np.linalg.pinv(Sigma[k:, k:], hermitian=True)
        M = Sigma[:k, :k] - gain @ Sigma[k:, :k] + self.cell**2 * np.eye(k)
        motions: list[Array] = []
        votes: list[int] = []
        for turn in turns:
            delta = np.concatenate([gain @ turn, turn])
            r = e + J @ delta
            r = r[mahalanobis(r, M) < self.gate]
            if not len(r):
                continue
            for aside in (0.0, 0.5):  # the cells of one grid lie over the corners of the other
                cells = np.floor(r / (2 * self.cell) + aside).astype(np.intp)
                bits = 1 << 21  # cells along an axis, so that the name of a cell is one whole number
                names = ((cells - cells.min(axis=0)) % bits) @ (bits ** np.arange(k)[::-1])
                _, first, count = np.unique(names, return_index=True, return_counts=True)
                best = int(count.argmax())
                shift = (cells[first[best]] + 0.5 - aside) * 2 * self.cell
                motions.append(np.concatenate([delta[:k] - shift, turn]))
                votes.append(int(count[best]))
        return np.stack(motions)[np.argsort(-np.array(votes), kind="stable")[:6]] if motions else none

    def shifts(self) -> Array:
        """Motions (q, m) that shift map b a little way, along the two axes of its largest extent."""
        b, (_, k, m) = self.b.p, self.J.shape
        x, y = np.linalg.svd(b - b.mean(axis=0), full_matrices=False)[2][:2]
        angles = np.arange(8) * pi / 4
        aside = np.outer(np.cos(angles), x) + np.outer(np.sin(angles), y)
        away = self.cell * np.array([6.0, 9.0])  # where it matches by chance
        return np.pad(np.multiply.outer(away, aside).reshape(-1, k), ((0, 0), (0, m - k)))


def _turns(Sigma: Array, step: float) -> Array:
    """Turns (n, r) within three sigmas, in steps along the axes of the covariance (r, r) that are longer; or none."""
    w, V = np.linalg.eigh(Sigma)
    most = 3.0 * np.sqrt(np.maximum(w, 0.0))
    steps = np.where(most > step, np.ceil(most / step), 0.0)
    if np.prod(2 * steps + 1) > MOST_MOTIONS:
        return np.zeros((0, len(w)))
    axes = [np.linspace(-s, s, 2 * int(n) + 1) if n else np.zeros(1) for s, n in zip(most, steps, strict=True)]
    return np.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(w)) @ V.T)
