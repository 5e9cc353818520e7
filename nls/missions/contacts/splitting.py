r"""Landmarks that are two: how much better the graph fits where some pieces of a landmark are a landmark of their own.

The sightings i of a piece p pull at their landmark. At the optimum all pulls add up to nothing:

    g_p = sum A_l,i' b_i

Pieces of another target pull to another side. So the pieces are put in the order of their pulls, along the axis of the
largest ones, and cut in two at any place. If the pieces S before the cut may move by a common delta, chi2 falls by

    g_S' Lambda^-1 g_S,    g_S = sum of g_p over p in S

in one step of Gauss-Newton: a score test. Lambda is the information of delta, with all else in the graph at its best. A
wrong join need not show in its residuals, because the map gives way to it. It shows in its pull. Every landmark is cut
where chi2 would fall most with all poses held. For Lambda the pieces S have a place l_S of their own, tied to that of
the others with a sigma t; the information of the tie is taken out again:

    Lambda = cov(l_S - l)^-1 - I / t^2 (+ I / e^2: no contact is farther from the middle of its arc than e)

Source: C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Mathematical
Proceedings of the Cambridge Philosophical Society 44, 1948.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors import Between, Isotropic
from factors.replaced import replaced
from models import R
from models.algebra import Array, Index, Mask, apply
from nls.analysis.chi_squared import mahalanobis
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.missions.contacts import partition
from nls.missions.contacts.estimate import KERNEL, Estimate
from nls.missions.contacts.gates import quadratic
from nls.missions.contacts.pings import Pings, without


class Cuts:
    """The cut of every landmark of several pieces: the one of which chi2 falls most, if no pose may move.

    Parameters
    ----------
    pings : the sightings.
    graph : the measurements of `estimate` without them.
    estimate : of tracks.
    pieces : (n,) a finer partition than these.

    Attributes
    ----------
    tied : the estimate with the pieces before each cut as a landmark of their own, tied to the others. Such a landmark
        has the number of the whole one, and `len(pings)` more. Without landmarks of several pieces the same estimate.
    """

    def __init__(self, pings: Pings, graph: FactorGraph, estimate: Estimate, pieces: Index) -> None:
        tracks, dim = estimate.tracks, pings.group.point_dim
        self.tied, self._d = estimate, np.flatnonzero(partition.several(tracks, pieces))
        if not len(self._d):
            return
        names, piece = np.unique(np.column_stack([tracks, pieces])[self._d], axis=0, return_inverse=True)
        piece, (landmark, which) = piece.reshape(-1), np.unique(names[:, 0], return_inverse=True)
        pull, own = _pulls(pings, estimate, self._d, piece)
        order = _by_pull(which, pull)
        self._rough = np.eye(dim) / pings.extent.max() ** 2 if pings.limit else np.zeros((dim, dim))
        cut, self._g = _cuts(which, pull[order], own[order], self._rough)
        self._spread, self._which = _spread_of_pulls(estimate, np.bincount(piece), which), which[piece]
        self._apart = np.argsort(order)[piece] <= cut[self._which]
        sigma = 0.05 * float(np.sqrt(np.median(pings.variances)))  # tighter ties cost digits
        i, j = pings.kind[landmark], pings.kind[landmark + len(tracks)]
        self._tie, self._information = Between(i, j, np.zeros(dim), Isotropic(sigma)), np.eye(dim) / sigma**2
        self.tied = _tied(pings, graph, estimate, self._d[self._apart], self._tie)

    def leaving(self, marginals: Marginals, gate: float) -> Mask:
        """Sightings (n,) that leave their landmarks together: without them chi2 falls by more than the gate.

        Parameters
        ----------
        marginals : of `tied`.
        gate : bound on the fall of chi2. It grows with the error that the sightings of a piece share.
        """
        leaving = np.zeros(len(self.tied.tracks), dtype=bool)
        if len(self._d):
            Lambda = np.linalg.inv(marginals.relative(*self._tie.keys)) - self._information
            falls = mahalanobis(self._g, Lambda + self._rough)  # with all else at its best
            leaving[self._d] = self._apart & (falls > gate * self._spread)[self._which]
        return leaving


def _pulls(pings: Pings, estimate: Estimate, d: Index, piece: Index) -> tuple[Array, Array]:
    """g_p (k, dim) of pieces (n,) of sightings d (n,), and their information (k, dim, dim), with robust weights."""
    _, _, (_, A_l), b = estimate.linearized(pings, d, estimate.tracks[d])
    w, k, dim = KERNEL.weight((b * b).sum(axis=1)), int(piece.max()) + 1, pings.group.point_dim
    pull, own = np.zeros((k, dim)), np.zeros((k, dim, dim))
    np.add.at(pull, piece, w[:, None] * apply(A_l.mT, b))
    np.add.at(own, piece, w[:, None, None] * (A_l.mT @ A_l))
    return pull, own


def _by_pull(which: Index, pull: Array) -> Index:
    """The order of pieces (k,), landmark (k,) by landmark, along the axis of the largest pulls (k, dim) there."""
    scatter = np.zeros((int(which.max()) + 1, pull.shape[1], pull.shape[1]))
    np.add.at(scatter, which, pull[:, :, None] * pull[:, None])
    axis = np.linalg.eigh(scatter)[1][..., -1]
    return np.lexsort(((pull * axis[which]).sum(axis=1), which))


def _cuts(which: Index, pull: Array, own: Array, rough: Array) -> tuple[Index, Array]:
    """The piece (q,) after which every landmark is cut, and g_S (q, dim): chi2 falls most there if no pose may move.

    Parameters
    ----------
    which, pull, own : (k,) landmark, g_p (k, dim) and information (k, dim, dim) of the pieces in their order.
    rough : (dim, dim) information of a landmark without any piece.
    """
    first, last = np.flatnonzero(np.diff(which, prepend=-1)), np.flatnonzero(np.diff(which, append=-1))
    g, Lambda = (np.cumsum(of_piece, axis=0) for of_piece in (pull, own))
    g, Lambda = g - (g - pull)[first][which], Lambda - (Lambda - own)[first][which]
    inside = np.delete(np.arange(len(which)), last)
    both = Lambda[inside] + rough, Lambda[last][which[inside]] - Lambda[inside] + rough
    fall = np.full(len(which), -1.0)
    fall[inside] = quadratic(g[inside], np.linalg.inv(both[0]) + np.linalg.inv(both[1]))
    cut = np.flatnonzero(partition.largest(which, fall))
    return cut, g[cut]


def _spread_of_pulls(estimate: Estimate, size: Index, which: Index) -> Array:
    """The variance of pulls (q,), landmark by landmark, over that of independent errors.

    Where chi2 is below its degrees of freedom, sigmas are wider than the scatter of sightings. The rest of the error is
    one that all sightings of a piece share, as when a tree is seen from one side.

    size, which : (k,) sightings of each piece, and its landmark.
    """
    s = min(1.0, estimate.reduced_chi2)
    return np.asarray(s + (1 - s) * np.bincount(which, size**2) / np.bincount(which, size))


def _tied(pings: Pings, graph: FactorGraph, estimate: Estimate, apart: Index, tie: Between) -> Estimate:
    """An estimate whose sightings `apart` leave their landmarks (q,) for those that these are tied to."""
    tracks, dim = estimate.tracks, pings.group.point_dim
    sightings, *apertures = estimate.graph.factors[len(graph.factors) :]
    chosen, targets = np.flatnonzero(partition.sizes(tracks) > 1), tracks.copy()
    targets[apart] += len(tracks)
    numbers = np.unique(targets[chosen])
    values = without(estimate.values, pings.kind)
    values.add(pings.kind, R(dim), estimate.values[pings.kind[numbers % len(tracks)]], numbers)
    sightings = replaced(sightings, [sightings.keys[0], pings.kind[targets[chosen]]])
    whole = FactorGraph([*graph.factors, sightings, tie, *apertures], graph.fixed)
    return replace(estimate, graph=whole, values=values)
