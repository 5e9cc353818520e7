r"""Landmarks that no single sighting locates: sightings wait, beside copies of the poses they were made from.

    waiting   A_c delta_c + A_l delta_l = b + v       delta_c ~ N(0, P_cc) of the copies, all sightings of one landmark
    l         argmin chi2 = b' S^-1 b,  S = A_c P_cc A_c' + I,  Lambda = A_l' S^-1 A_l       from many places at once
    located   A_l = [Q_1 Q_2] [R; 0]                  delta_l = R^-1 Q_1' (b - A_c delta_c + v)        is added
                                                      Q_2' A_c delta_c = Q_2' b + v                    is an update

It is located once it is known to a tenth of its distance, where no second place explains the sightings as well. Then
each of its sightings has been used exactly once; those that left with a pose, `given_up`, never were.

Sources: T. Bailey, "Constrained initialisation for bearing-only SLAM", ICRA 2003 (sightings that wait, beside their
poses); S. I. Roumeliotis, J. W. Burdick, "Stochastic cloning", ICRA 2002 (the copies); A. I. Mourikis, S. I.
Roumeliotis, "A multi-state constraint Kalman filter for vision-aided inertial navigation", ICRA 2007 (Q_2).
"""

from collections.abc import Callable, Sequence

import numpy as np

from factors import Factor, Sighting
from factors.joined import joined
from factors.keys import Keys
from models import LieGroup, Manifold, R
from models.algebra import Array, Index, Mask, apply
from models.chi_squared import chi2_gate
from models.sensors import cartesian
from nls.filters.map_state import MapState, Measurements, rows_of, select
from nls.filters.motion import copies

COPIES = 40  # poses that are copied at most
BEGINNINGS = 60  # of a search, on a circle, a sphere, an arc, or a ray

Views = Sequence[tuple[Factor, Index]]  # sightings of one landmark, and the copy (n,) each was made from


def can_wait(factor: Factor, spaces: tuple[Manifold, ...]) -> bool:
    """Sightings of points can wait, but not those of a camera: places behind it have no image, and are not tried."""
    if not isinstance(factor, Sighting) or factor.states("rays"):
        return False
    return isinstance(spaces[0], LieGroup) and spaces[1] is R(spaces[0].point_dim)


class Waiting:
    """Sightings of landmarks that are not located yet.

    Parameters
    ----------
    state : has the copies of the poses they were made from, and takes the landmarks.

    Attributes
    ----------
    sightings : in batches of one kind.
    poses : numbers (c,) of the poses that are copied, in the order of the copies.
    numbers : landmarks (w,) that were seen and are not located.
    given_up : how many sightings left with their pose, and never were used.
    """

    def __init__(self, state: MapState) -> None:
        self.state, self.given_up = state, 0
        self.sightings: list[Factor] = []
        self.poses = self.numbers = np.zeros(0, dtype=np.int64)

    def take(self, pose: Keys, pieces: Sequence[Measurements]) -> list[Measurements]:
        """Keep sightings of landmarks that are not in the map, add those that are located now; returns what is left."""
        spaces, rows = self.state.spaces, self.state.rows
        masks = [(rows(factor.keys[-1].numbers) < 0) & can_wait(factor, spaces) for factor, _ in pieces]
        kept = [factor[mask] for mask, (factor, _) in zip(masks, pieces, strict=True) if mask.any()]
        if kept:
            self.state.pick(np.append(1 + np.arange(len(self.poses)), 0))
            self.poses = np.append(self.poses, pose.numbers)
            self.sightings = joined([factor.bind(*spaces) for factor in (*self.sightings, *kept)])
        every, new = (np.array([n for f in fs for n in f.keys[1].numbers], dtype=int) for fs in (self.sightings, kept))
        for number in np.union1d(new, every[rows(every) >= 0]).tolist():  # located since, by a prior or a new sighting
            self._locate(number, pose)
        self.numbers = np.union1d(self.numbers, new)
        self.numbers = self.numbers[rows(self.numbers) < 0]
        if len(self.poses) > COPIES:
            p, before = spaces[0].position(self.state.copies), sum(map(len, self.sightings))
            between = self.poses[1 + np.argmin(np.linalg.norm(p[2:] - p[:-2], axis=1))]  # the two nearest
            self._keep(lambda factor: factor.keys[0].numbers != between)
            self.given_up += before - sum(map(len, self.sightings))
        return [select(piece, ~mask) for piece, mask in zip(pieces, masks, strict=True)]

    def _keep(self, wanted: Callable[[Factor], Mask]) -> None:
        """Keep the wanted sightings, and copies of poses that one of them was made from."""
        self.sightings = [factor[mask] for factor in self.sightings if (mask := wanted(factor)).any()]
        needed = np.isin(self.poses, [n for factor in self.sightings for n in factor.keys[0].numbers.tolist()])
        if not needed.all():
            self.state.pick(1 + np.flatnonzero(needed))
            self.poses = self.poses[needed]

    def _locate(self, number: int, pose: Keys) -> None:
        """Add a landmark, and what else its sightings say; nothing where they do not say where it is."""
        state, d, numbers = self.state, self.state.spaces[0].dim, np.array([number])
        parts = [factor[mask] for factor in self.sightings if (mask := factor.keys[1].numbers == number).any()]
        views = [(part, rows_of(part.keys[0].numbers, self.poses)) for part in parts]
        row = state.rows(numbers)
        if (L := place(state, views) if row[0] < 0 else state.L[row]) is None:
            return
        (A_x,), at, (A_l,), (b,) = stacked_at(state, views, L)
        A = (A_x[:, None, :] * (at[:, None] == np.arange(len(state.copies)))[:, :, None]).reshape(len(b), -1)
        if row[0] < 0:
            Q, T = np.linalg.qr(A_l, mode="complete")
            A, b, k = Q.T @ A, Q.T @ b, A_l.shape[1]
            B = np.linalg.inv(T[:k])
            L = state.spaces[1].retract(L, (B @ b[:k])[None])
            state.add(numbers, L, -(B @ A[:k])[None], (B @ B.T)[None], slice(d, state.begin))
            A, A_l, b = A[k:], T[k:], b[k:]
        if len(b):
            columns = np.append(np.arange(d, state.begin), state.columns(state.rows(numbers)))
            state.update(np.concatenate([A, A_l], axis=1), columns, b, pose)
        self._keep(lambda factor: factor.keys[1].numbers != number)


def stacked_at(state: MapState, views: Views, L: Array) -> tuple[Array, Index, Array, Array]:
    """A_x (N, M, d) of the copies (M,), A_l (N, M, k) and b (N, M), with the landmark at places L (N, k)."""
    N, blocks, copied = len(L), [], []
    for view, at in views:
        X = np.broadcast_to(state.copies[at], (N, len(at), state.copies.shape[1]))
        (A_x, A_l), b = copies(view, state.spaces, N).linearize(X, L)
        blocks.append((A_x.reshape(N, -1, A_x.shape[2]), A_l.reshape(N, -1, L.shape[1]), b.reshape(N, -1)))
        copied.append(np.repeat(at, b.shape[1]))
    A_x, A_l, b = (np.concatenate(column, axis=1) for column in zip(*blocks, strict=True))
    return A_x, np.concatenate(copied), A_l, b


def judged(state: MapState, views: Views, L: Array, P: Array) -> tuple[Array, Array, Array]:
    """chi2 (N,) of places L, the information Lambda (N, k, k) and gradient (N, k) there; P is of the copies."""
    A_x, at, A_l, b = stacked_at(state, views, L)
    blocks = P.reshape(len(state.copies), A_x.shape[2], len(state.copies), -1)[at][:, :, at]
    S = np.einsum("nid,idje,nje->nij", A_x, blocks, A_x, optimize=True) + np.eye(len(at))
    W = np.linalg.solve(S, np.concatenate([A_l, b[..., None]], axis=2))
    return (b * W[..., -1]).sum(axis=1), A_l.mT @ W[..., :-1], apply(A_l.mT, W[..., -1])


def place(state: MapState, views: Views) -> Array | None:
    """The one place (1, k) that explains the sightings; None where there is none, or not one alone."""
    used, d = np.unique(np.concatenate([at for _, at in views])), state.spaces[0].dim
    positions = state.spaces[0].position(state.copies[used])
    rows = sum(len(view) * view.bind(*state.spaces).dim for view, _ in views if not view.limit_only)
    L = next((p for view, at in views if len(p := _beginnings(state, view, at, positions))), None)
    if L is None or rows < (k := L.shape[1]):
        return None
    P, mu = state.P[d : state.begin, d : state.begin], np.full(len(L), 1e-2)
    chi2, Lambda, g = now = judged(state, views, L, P)
    tried = [np.column_stack([L, chi2])]
    for _ in range(15):
        damped = Lambda + (mu * np.trace(Lambda, axis1=1, axis2=2))[:, None, None] * np.eye(k)
        step = np.linalg.solve(damped, g[..., None])[..., 0]
        moving = np.flatnonzero((step * apply(Lambda, step)).sum(axis=1) > 1e-4)  # sigma^2
        if not len(moving):
            break
        trial = judged(state, views, L[moving] + step[moving], P)
        better = trial[0] < chi2[moving]
        mu[moving] = np.where(better, np.maximum(mu[moving] / 10, 1e-9), mu[moving] * 10)
        nearer = moving[better]
        L[nearer] += step[nearer]
        for old, new in zip(now, trial, strict=True):
            old[nearer] = new[better]
        tried.append(np.column_stack([L, chi2]))
    best = int(np.argmin(chi2))
    away = np.linalg.norm(positions - L[best], axis=1)
    near = used[np.argmin(away)] * d + np.arange(d)
    P_near = P - P[:, near] @ np.linalg.solve(P[near[:, None], near], P[near])  # that pose held
    least = np.linalg.eigvalsh(judged(state, views, L[[best]], P_near)[1][0])[0]
    off = np.concatenate(tried) - [*L[best], chi2[best]]
    # Beyond 20 of chi2 above the least a place is 22,000 times less likely. Another place is farther off than 1 sigma^2
    # and 4 more for each unit of chi2.
    rival = (off[:, k] < 20.0) & ((off[:, :k] * (off[:, :k] @ Lambda[best])).sum(axis=1) > 1.0 + 4.0 * off[:, k])
    explained = rows == k or chi2[best] <= chi2_gate(rows - k, 0.9999)
    return L[[best]] if explained and least * (0.1 * away.min()) ** 2 >= 1 and not rival.any() else None


def _beginnings(state: MapState, view: Factor, at: Index, positions: Array) -> Array:
    """Where the first of some sightings leaves the landmark, (N, k): circle, sphere, arc or ray; (0, k) anywhere."""
    first, k, group = view[[0]], state.spaces[1].dim, state.spaces[0]
    assert isinstance(first, Sighting)
    assert isinstance(group, LieGroup)
    z, around = first.bind(*state.spaces).z, np.random.default_rng(0).normal(size=(BEGINNINGS, k))
    spread = np.linalg.norm(positions - positions[0], axis=1).max()
    if first.contact:
        p = cartesian(np.column_stack([np.repeat(z, BEGINNINGS, axis=0), np.linspace(-1.5, 1.5, BEGINNINGS)]))[0]
    elif (r := first.ranges(z)) is not None:
        p = r * around / np.linalg.norm(around, axis=1, keepdims=True)
    elif (u := first.directions(z)) is not None and spread > 0:
        p = spread * np.geomspace(0.1, 1e3, BEGINNINGS)[:, None] * u
    else:
        return np.zeros((0, k))
    S = np.repeat(first.sensor_pose(group, state.copies[at[:1]]), BEGINNINGS, axis=0)
    return group.act(S, p + 1e-3 * around)  # m aside: at the sensor itself, range 0, nothing has a direction
