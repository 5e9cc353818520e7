r"""Landmarks that are two: how much better the graph fits where some pieces of a landmark are a landmark of their own.

The sightings i of a piece p pull at their landmark. At the optimum all pulls add up to nothing:

    g_p = sum A_l,i' b_i

Pieces of another target pull to another side. So the pieces are put in the order of their pulls, along the axis of the
largest ones, and cut in two at any place. If the pieces S before the cut may move by a common delta, chi2 falls by

    g_S' Lambda^-1 g_S,    g_S = sum of g_p over p in S

in one step of Gauss-Newton: a score test. Lambda is the information of delta, with all else in the graph at its best. A
wrong join need not show in its residuals, because the map gives way to it. It shows in its pull. For Lambda each piece
has a place l_p of its own, tied to that of the next; the information of the tie is taken out again:

    Lambda = cov(l_p - l_p+1)^-1 - I / TIE^2 (+ I / e^2: no contact is farther from the middle of its arc than e)

Source: C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Mathematical
Proceedings of the Cambridge Philosophical Society 44, 1948.
"""

from __future__ import annotations

import numpy as np

from factors import Between, Isotropic
from factors.replaced import replaced
from models import R
from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import mahalanobis
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.estimate import KERNEL, Estimate, without
from nls.sonar.contacts.places import Pings

__all__ = ["split"]

TIE = 1e-3  # m


def split(pings: Pings, graph: FactorGraph, estimate: Estimate, pieces: Index, gate: float) -> Mask:
    """Sightings (n,) that leave their landmarks together: pieces (n,) without which chi2 falls by more than the gate.

    Parameters
    ----------
    pings : the sightings.
    graph : the measurements of `estimate` without them.
    estimate : of tracks.
    pieces : (n,) a finer partition than these.
    gate : bound on the fall of chi2. Odometry that promises too much makes all landmarks pull. So the bound grows with
        the median of their falls, where that is above the one of noise. It grows as well with the error that the
        sightings of a piece share.
    """
    tracks, n, dim = estimate.tracks, len(pieces), pings.group.point_dim
    leaving = np.zeros(n, dtype=bool)
    d = np.flatnonzero(of.several(tracks, pieces))
    if not len(d):
        return leaving
    names, piece = np.unique(np.column_stack([tracks[d], pieces[d]]), axis=0, return_inverse=True)
    piece, landmark = piece.reshape(-1), names[:, 0]
    pull = _pulls(pings, estimate, d, piece)
    order = _by_pull(landmark, pull)  # landmark by landmark, as they are
    begins = np.append(True, landmark[1:] != landmark[:-1])
    first, which = np.flatnonzero(begins), np.cumsum(begins) - 1
    g = np.cumsum(pull[order], axis=0)
    g -= (g - pull[order])[first][which]
    cut = np.flatnonzero(~begins) - 1  # after these pieces, in that order
    place, rank = np.where(begins, landmark, n + np.arange(len(names))), np.argsort(order)[piece]
    Lambda = _information(pings, graph, estimate, d, place[rank], place[cut], place[cut + 1])
    fall = np.zeros(len(names))
    fall[cut] = mahalanobis(g[cut], Lambda)
    most = np.maximum.reduceat(fall, first)
    whole = np.zeros(len(np.unique(tracks[of.sizes(tracks) > 1])) - len(most))  # landmarks of one piece
    usual = max(1.0, float(np.median([*most, *whole])) / dim) * _spread_of_pulls(estimate, np.bincount(piece), first)
    last = np.full(len(first), -1)  # of the pieces that leave
    large = np.flatnonzero((fall == most[which]) & (fall > gate * usual[which]))
    last[which[large]] = large
    leaving[d] = rank <= last[which[rank]]
    return leaving


def _pulls(pings: Pings, estimate: Estimate, d: Index, piece: Index) -> Array:
    """g_p (k, dim) of pieces (n,) of sightings d (n,), with the weights of the robust kernel."""
    _, _, (_, A_l), b = estimate.linearized(pings, d, estimate.tracks[d])
    pull = np.zeros((int(piece.max()) + 1, pings.group.point_dim))
    np.add.at(pull, piece, KERNEL.weight((b * b).sum(axis=1))[:, None] * (A_l.mT @ b[..., None])[..., 0])
    return pull


def _by_pull(landmark: Index, pull: Array) -> Index:
    """The order of pieces (k,), landmark by landmark, along the axis of the largest pulls (k, dim) there."""
    _, which = np.unique(landmark, return_inverse=True)
    scatter = np.zeros((int(which.max()) + 1, pull.shape[1], pull.shape[1]))
    np.add.at(scatter, which, pull[:, :, None] * pull[:, None])
    axis = np.linalg.eigh(scatter)[1][..., -1]
    return np.lexsort(((pull * axis[which]).sum(axis=1), landmark))


def _spread_of_pulls(estimate: Estimate, size: Index, first: Index) -> Array:
    """The variance of pulls (q,), landmark by landmark, over that of independent errors.

    Where chi2 is below its degrees of freedom, sigmas are wider than the scatter of sightings. The rest of the error is
    one that all sightings of a piece share, as when a tree is seen from one side.

    size : (k,) sightings of each piece, landmark by landmark; the first piece of each is `first` (q,).
    """
    s = min(1.0, estimate.reduced_chi2)
    return np.asarray(s + (1 - s) * np.add.reduceat(size**2, first) / np.add.reduceat(size, first))


def _information(
    pings: Pings, graph: FactorGraph, estimate: Estimate, d: Index, target: Index, before: Index, after: Index
) -> Array:
    """Lambda (c, dim, dim) of cuts between places before (c,) and after (c,), that sightings d look for at targets."""
    tracks, values, dim = estimate.tracks, estimate.values, pings.group.point_dim
    sightings, *apertures = estimate.graph.factors[len(graph.factors) :]
    chosen, targets = np.flatnonzero(of.sizes(tracks) > 1), tracks.copy()
    targets[d] = target
    numbers, place = np.unique(targets[chosen], return_index=True)
    tied = without(values, pings.kind)
    tied.add(pings.kind, R(dim), values[pings.kind[tracks[chosen][place]]], numbers)
    i, j = pings.kind[before], pings.kind[after]
    sightings = replaced(sightings, [sightings.keys[0], pings.kind[targets[chosen]]])
    tie = Between(i, j, np.zeros(dim), Isotropic(TIE))
    marginals = Marginals(FactorGraph([*graph.factors, sightings, tie, *apertures], graph.fixed), tied)
    Lambda = np.linalg.inv(marginals.relative(i, j)) - np.eye(dim) / TIE**2
    return np.asarray(Lambda + np.eye(dim) / pings.extent.max() ** 2 if pings.limit else Lambda)
