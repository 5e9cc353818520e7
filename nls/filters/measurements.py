"""Measurements of one step for the EKF: parts of factors, their rows stacked over the state, and all their pairings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.base import Factor, Model
from factors.sighting import Sighting
from models import Manifold
from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import chi2_gate, mahalanobis
from nls.filters.association import Association, Candidates
from nls.filters.base import POSE
from nls.filters.map_state import MapState

Measurements = tuple[Factor, Index | None]  # measurements, and the landmark (n,) of each; None where they touch none


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
    S = A @ state.P[columns[:, :, None], columns[:, None, :]] @ A.mT + np.eye(model.dim)
    return mahalanobis(b, S), b


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
