r"""The belief of an EKF: the latest pose, copies of earlier ones, all landmarks; normal with one joint covariance.

    x = X Exp(delta),  l = L [+] delta_l,     delta ~ N(0, P),   P = [[P_xx, P_xl], [P_lx, P_ll]]

Four things happen to it, with whitened Jacobians A and innovations b of factors (R is then the identity):

    predict   delta_j = F delta_i + w        P_xx <- F P_xx F' + Q,  P_xl <- F P_xl       the rest is not touched: O(n)
    add       delta_l = G delta_x + w        P_ll = G P_xx G' + Q,   P_l. = G P_x.        O(n)
    update    A delta = b + v                S = A P A' + I,  P <- P - P A' S^-1 A P      O(n^2)
    pick      delta_c = delta_x              rows and columns of P repeated, or left out  O(n^2)

The tangent space of a pose turns with it. After an update has turned X to X', errors keep their components along the
axes of the world: P_x. <- G(X')^-1 G(X) P_x., G as in `Manifold.world_axes`. What no measurement sees, a shift of
everything, then stays unseen.

The measurements of one step are parts of factors, with their rows stacked over the state, and all their pairings.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from factors.base import Factor, Model
from factors.keys import Keys
from factors.sighting import Sighting
from models import Manifold
from models.algebra import Array, Index, Mask
from models.chi_squared import chi2_gate, innovation_distances
from models.errors import EvaluationError
from nls.filters.association import Association, Candidates
from nls.filters.base import POSE

Measurements = tuple[Factor, Index | None]  # measurements, and the landmark (n,) of each; None where they touch none
ROWS_TOGETHER = 128  # rows of P updated together: 3,200 landmarks take 0.4 s, and 1.3 s with V'V in memory as a whole


class MapState:
    """Pose X (size,), copies of poses (c, size), landmarks L (m, size) by `numbers`, and P (n, n), in this order.

    Parameters
    ----------
    spaces : of the pose, and of a landmark.
    X, P : the first pose (size,) and its covariance (d, d).
    frozen : Jacobians are wanted at the first estimate of every variable: `first` then stays where it is, and so does
        the tangent space of P.
    """

    def __init__(self, spaces: tuple[Manifold, Manifold], X: Array, P: Array, frozen: bool) -> None:
        self.spaces, self.frozen = spaces, frozen
        self.X, self.first, self.copies = X, X, np.zeros((0, spaces[0].size))
        self._moved = np.zeros(spaces[0].dim)  # X = first Exp(moved), where frozen
        self.L, self.L_first = np.zeros((0, spaces[1].size)), np.zeros((0, spaces[1].size))
        self.numbers = np.zeros(0, dtype=np.int64)
        self._P = P.copy()

    @property
    def n(self) -> int:
        """Unknowns: rows of P."""
        return self.begin + len(self.L) * self.spaces[1].dim

    @property
    def begin(self) -> int:
        """Column of P where the landmarks begin."""
        return self.spaces[0].dim * (1 + len(self.copies))

    @property
    def P(self) -> Array:
        """The joint covariance (n, n), a view."""
        return self._P[: self.n, : self.n]

    @property
    def pose_covariance(self) -> Array:
        """(d, d) in the tangent space at X."""
        d = self.spaces[0].dim
        J = self.turn(self.first[None], self.X[None])[0]
        return np.asarray(J @ self._P[:d, :d] @ J.T)

    @property
    def landmark_covariances(self) -> Array:
        """(m, k, k), the diagonal blocks."""
        columns = self.columns(np.arange(len(self.L)))
        return self._P[columns[:, :, None], columns[:, None, :]]

    def columns(self, rows: Index) -> Index:
        """Columns (r, k) of P that belong to landmarks by their row in L."""
        k = self.spaces[1].dim
        return np.asarray(self.begin + rows[:, None] * k + np.arange(k))

    def rows(self, numbers: Index) -> Index:
        """Row in L of landmarks by number; -1 for one that is not there."""
        return rows_of(numbers, self.numbers)

    def predict(self, X: Array, F: Array, Q: Array) -> None:
        """The next pose X (size,), of which delta = F delta_before + w, w ~ N(0, Q)."""
        d = self.spaces[0].dim
        self._poses_by(F[None])
        self._P[:d, :d] += Q
        self.X, self.first, self._moved = X, X, np.zeros(d)

    def pick(self, poses: Index) -> None:
        """Copies (c,) of these poses: 0 is the latest, which stays, 1 the first copy there is, and so on."""
        d = self.spaces[0].dim
        columns = (np.append(0, poses)[:, None] * d + np.arange(d)).reshape(-1)
        columns = np.append(columns, np.arange(self.begin, self.n))
        self._P = self._P[columns[:, None], columns]
        self.copies = np.concatenate([self.X[None], self.copies])[poses]

    def add(self, numbers: Index, L: Array, G: Array, Q: Array, poses: slice | None = None) -> None:
        """New landmarks (r,) at L (r, size), of which delta = G delta_x + w: G (r, k, d), w ~ N(0, Q), Q (r, k, k).

        delta_x is of the latest pose, or of these columns of P.
        """
        poses, begin = slice(self.spaces[0].dim) if poses is None else poses, self.n
        n = begin + len(numbers) * self.spaces[1].dim
        if n > len(self._P):
            grown = np.zeros((max(n, 2 * len(self._P)),) * 2)
            grown[:begin, :begin] = self.P
            self._P = grown
        P, G = self._P, G.reshape(-1, G.shape[-1])
        P[begin:n, :begin] = G @ P[poses, :begin]
        P[:begin, begin:n] = P[begin:n, :begin].T
        P[begin:n, begin:n] = _symmetric(G @ P[poses, poses] @ G.T)
        self.L, self.L_first = (np.concatenate([stack, L]) for stack in (self.L, self.L_first))
        self.numbers = np.concatenate([self.numbers, numbers])
        own = self.columns(np.arange(len(self.L) - len(numbers), len(self.L)))
        P[own[:, :, None], own[:, None, :]] += Q

    def update(self, A: Array, columns: Index, b: Array, pose: Keys) -> None:
        """Whitened rows A (M, c) over some columns (c,) of P, and innovations b (M,); `pose` is for the message.

        Raises
        ------
        EvaluationError
            P is no covariance any more: A P A' + I has no Cholesky factor, or numbers that are not finite.
        """
        V, y = self._gain(A, columns, b, pose)
        P = self.P
        for begin in range(0, len(P), ROWS_TOGETHER):
            rows = slice(begin, begin + ROWS_TOGETHER)
            P[rows] -= V[:, rows].T @ V
        self._move(V.T @ y)

    def step(self, A: Array, columns: Index, b: Array, pose: Keys) -> Array:
        """The step (n,) that `update` would take; nothing is changed."""
        V, y = self._gain(A, columns, b, pose)
        return np.asarray(V.T @ y)

    def moved(self, delta: Array) -> MapState:
        """Where a step (n,) leads, to linearize there; P is that of here, in the tangent space of here."""
        target, d = copy(self), self.spaces[0].dim
        target.X = target.first = self.spaces[0].retract(self.X[None], delta[None, :d])[0]
        target.L = target.L_first = self._landmarks_at(delta)
        return target

    def _gain(self, A: Array, columns: Index, b: Array, pose: Keys) -> tuple[Array, Array]:
        """V = C^-1 A P and y = C^-1 b, S = C C': P - V'V is what is left of P, and V'y the step."""
        P = self.P
        AP = A @ P[columns]
        S = AP[:, columns] @ A.T + np.eye(len(A))
        if not np.isfinite(S).all():
            message = "the covariance of its innovations is not finite; check sigmas and units"
            raise EvaluationError(f"EKF at {pose}: {message}", keys=[pose])
        try:
            C = np.linalg.cholesky(_symmetric(S))
        except np.linalg.LinAlgError as error:
            raise EvaluationError(
                f"EKF at {pose}: the covariance of its innovations is not positive: sigmas of prior and measurements "
                "differ by more than the digits of P hold; tighten the prior of the first pose, check sigmas and units",
                keys=[pose],
            ) from error
        # by NumPy: the BLAS of SciPy, loaded within `single_thread`, would keep all its threads
        return np.linalg.solve(C, AP), np.linalg.solve(C, b)

    def _move(self, delta: Array) -> None:
        """Every variable by its part of a step (n,)."""
        pose, d = self.spaces[0], self.spaces[0].dim
        self.L = self._landmarks_at(delta)
        if self.frozen:
            self._moved = self._moved + delta[:d]
            self.X = pose.retract(self.first[None], self._moved[None])[0]
        else:
            before = np.concatenate([self.X[None], self.copies])
            after = pose.retract(before, delta[: self.begin].reshape(-1, d))
            self._poses_by(self.turn(before, after))
            self.X, self.copies, self.first = after[0], after[1:], after[0]
            self.L_first = self.L

    def _landmarks_at(self, delta: Array) -> Array:
        """The landmarks (m, size) a step (n,) from where they are."""
        landmark = self.spaces[1]
        return landmark.retract(self.L, delta[self.begin :].reshape(-1, landmark.dim))

    def _poses_by(self, F: Array) -> None:
        """P of F (p, d, d) times the errors of the latest pose and of copies: p d rows and columns, all else stays."""
        p, d = F.shape[:2]
        P, e = self.P, p * d
        P[:e, e:] = (F @ P[:e, e:].reshape(p, d, -1)).reshape(e, -1)
        P[e:, :e] = P[:e, e:].T
        left = (F @ P[:e, :e].reshape(p, d, e)).reshape(e, e)
        P[:e, :e] = _symmetric((F @ left.T.reshape(p, d, e)).reshape(e, e))

    def turn(self, X: Array, Y: Array) -> Array:
        """Components in the tangent spaces at Y of errors whose components in those at X are given, (p, d, d)."""
        return np.asarray(np.linalg.solve(self.spaces[0].world_axes(Y), self.spaces[0].world_axes(X)))


def rows_of(landmarks: Index, numbers: Index) -> Index:
    """Places (n,) of the wanted numbers (n,) among numbers (m,) in any order; -1 for one that is not there."""
    if not len(numbers):
        return np.full(len(landmarks), -1)
    order = np.argsort(numbers)
    at = order[np.minimum(np.searchsorted(numbers, landmarks, sorter=order), len(order) - 1)]
    return np.where(numbers[at] == landmarks, at, -1)


def _symmetric(P: Array) -> Array:
    return (P + P.T) / 2


def select(piece: Measurements, mask: Mask | None) -> Measurements:
    """Some of the measurements by a mask (n,); None for all."""
    factor, numbers = piece
    if mask is None or mask.all():
        return piece
    return factor[mask], None if numbers is None else numbers[mask]


def stacked(state: MapState, known: Sequence[tuple[Model, Index | None]]) -> tuple[Array, Index, Array]:
    """Whitened rows A (M, c), the columns (c,) of the state they touch, and innovations b (M,).

    Parameters
    ----------
    state : Jacobians are taken at its first estimates, innovations at its latest.
    known : models of measurements, with the row (n,) of the landmark of each in the state; None for none.
    """
    d, k = (space.dim for space in state.spaces)
    used = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *(rows for _, rows in known if rows is not None)]))
    columns = np.concatenate([np.arange(d), state.columns(used).reshape(-1)])
    blocks, innovations = [], []
    for model, rows in known:
        n = len(model.z)
        now, first = (
            [np.broadcast_to(x, (n, len(x))) if keys.kind == POSE else l[rows] for keys in model.factor.keys]
            for x, l in ((state.X, state.L), (state.first, state.L_first))
        )
        A, b = model.linearize(*first)
        if state.frozen:
            b = model.error(*now)
        block = np.zeros((n, model.dim, len(columns)))
        for A_k, keys in zip(A, model.factor.keys, strict=True):
            if keys.kind == POSE:
                block[:, :, :d] = A_k
            else:
                assert rows is not None
                at = d + np.searchsorted(used, rows)[:, None] * k + np.arange(k)  # (n, k)
                np.put_along_axis(block, np.broadcast_to(at[:, None, :], A_k.shape), A_k, axis=2)
        blocks.append(block.reshape(-1, len(columns)))
        innovations.append(b.reshape(-1))
    return np.concatenate(blocks), columns, np.concatenate(innovations)


def distances(state: MapState, model: Model, rows: Index) -> tuple[Array, Array]:
    """Squared Mahalanobis distances (n,) of sightings from the landmarks in these rows, and innovations b (n, m)."""
    d, n = state.spaces[0].dim, len(rows)
    (A_x, A_l), b = model.linearize(np.broadcast_to(state.X, (n, len(state.X))), state.L[rows])
    A = np.concatenate([A_x, A_l], axis=2)
    columns = np.concatenate([np.broadcast_to(np.arange(d), (n, d)), state.columns(rows)], axis=1)
    return innovation_distances(b, A @ state.P[columns[:, :, None], columns[:, None, :]] @ A.mT), b


def associated(state: MapState, associate: Association, factor: Sighting, manifolds: tuple[Manifold, ...]) -> Index:
    """Number of the landmark (n,) of each sighting: a known one, a new one, or -1 for one to be left out."""
    n, m = len(factor), len(state.L)
    i, j = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    every = factor[i]
    model = every.bind(*manifolds)
    d2, b = distances(state, model, j)
    d2 = d2.reshape(n, m)

    near = np.flatnonzero(d2.reshape(-1) <= chi2_gate(model.dim, associate.probability))
    A_near, used, _ = stacked(state, [(every[near].bind(*manifolds), j[near])])
    S_near = A_near @ state.P[np.ix_(used, used)] @ A_near.T + np.eye(len(A_near))
    at = associate(Candidates(d2, model.dim, np.stack([i[near], j[near]], axis=1), b[near], S_near))

    new = (at < 0) & (d2 > chi2_gate(model.dim, associate.new)).all(axis=1)
    first = int(state.numbers.max()) + 1 if m else 0
    numbers = np.append(state.numbers, -1)[at]
    numbers[new] = first + np.arange(int(new.sum()))
    return numbers
