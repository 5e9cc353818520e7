r"""The place of a beacon from ranges alone, measured from a track that is nearly level.

With positions p_i, u_i = (p_i - c) in the horizontal and their mean c, the squared ranges less their mean are linear:

    sum u_i u_i' l = sum u_i (|u_i|^2 - rho_i^2) / 2,   rho_i^2 = r_i^2 - (z - p_z,i)^2     l from c, in the horizontal

of a beacon of depth z. Without z the r_i themselves stand for rho_i, and the mean of r_i^2 - |l - u_i|^2 is
(z - p_z)^2, above or below. Along the shorter axis of the track the sums say little; there the mean says how far, to
one side or the other. All these candidates and their mirror images are improved by least squares with the weights of a
Cauchy kernel. The best one counts, of equal ones that below.

Source: E. Olson, J. Leonard, S. Teller, "Robust range-only beacon localization", IEEE J. Oceanic Engineering 31, 2006.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array

__all__ = ["beacon_of_ranges"]

PASSES = 30  # of the improvement
EXACT = 1e-9  # of the longest range: a scatter of rounding
BETTER, EVEN = 0.99, 1e-3  # of the misfit: one that is no better keeps the one before it


def beacon_of_ranges(p: Array, r: Array, z: float | None = None) -> Array:
    """The beacon (3,), m, of ranges r (n,) from positions p (n, 3), z down.

    Parameters
    ----------
    p : (n, 3) positions, m.
    r : (n,) ranges, m; some may be wrong by far.
    z : depth of the beacon, m; None where it is not known, and then below where above fits as well.

    Examples
    --------
    >>> import numpy as np
    >>> p = np.array([[0.0, 0, 1], [10, 0, 1], [10, 10, 1], [0, 10, 1], [5, 5, 1]])
    >>> r = np.linalg.norm(p - [40.0, -20.0, 12.0], axis=1)
    >>> beacon_of_ranges(p, r, 12.0).round(6), beacon_of_ranges(p, r).round(3)
    (array([ 40., -20.,  12.]), array([ 40., -20.,  12.]))
    """
    candidates = [_improved(candidate, p, r, z is None) for candidate in _candidates(p, r, z)]
    candidates += [_improved(_mirrored(candidate, p), p, r, z is None) for candidate in candidates]
    candidates.sort(key=lambda candidate: -candidate[2])  # those below first
    errors = [np.abs(np.linalg.norm(p - candidate, axis=1) - r) for candidate in candidates]
    scale = max(min(1.4826 * float(np.median(e)) for e in errors), EXACT * float(r.max()))
    best, least = 0, np.inf
    for k, e in enumerate(errors):
        misfit = float(np.log1p(np.square(e / scale)).sum())
        if misfit < BETTER * least - EVEN:
            best, least = k, misfit
    return candidates[best]


def _candidates(p: Array, r: Array, z: float | None) -> list[Array]:
    """Places (3,) where the beacon may be."""
    c = p.mean(axis=0)
    u = p[:, :2] - c[:2]
    drop = np.zeros(len(r)) if z is None else z - p[:, 2]
    rho2 = np.maximum(np.square(r) - np.square(drop), 0.0)
    spread, axes = np.linalg.eigh(u.T @ u)
    v = axes.T @ (u * ((np.square(u).sum(axis=1) - rho2) / 2)[:, None]).sum(axis=0)
    known = spread > EXACT * max(float(spread[1]), 1e-12)
    along = np.divide(v, spread, out=np.zeros(2), where=known)  # across the track, and along it
    left = float(rho2.mean() - np.square(u).sum(axis=1).mean() - along[1] ** 2)
    beside = np.sqrt(max(left, 0.0))
    over = np.sqrt(max(left - along[0] ** 2, 0.0)) if z is None else 0.0
    depth = c[2] if z is None else z
    places = [(along[0], depth + over)]
    if z is None:
        places += [(along[0], depth - over)]
        places += [(side * beside * np.sqrt(0.5), depth + beside * np.sqrt(0.5)) for side in (1, -1)]
    places += [(side * beside, depth) for side in (1, -1)]
    return [np.append(c[:2] + axes @ [across, along[1]], down) for across, down in places]


def _mirrored(place: Array, p: Array) -> Array:
    """A place on the other side of the longer axis of the track, from where ranges nearly fit as well."""
    c = p[:, :2].mean(axis=0)
    across = np.linalg.eigh((p[:, :2] - c).T @ (p[:, :2] - c))[1][:, 0]
    return np.append(place[:2] - 2 * across * (across @ (place[:2] - c)), place[2])


def _improved(place: Array, p: Array, r: Array, free: bool) -> Array:
    """A candidate moved by Gauss-Newton with the weights of a Cauchy kernel; its depth is held unless it is free."""
    l, dims = place.copy(), 3 if free else 2
    for _ in range(PASSES):
        d = l - p
        h = np.maximum(np.linalg.norm(d, axis=1), 1e-9)
        e = r - h
        scale = max(2.385 * 1.4826 * float(np.median(np.abs(e))), EXACT * float(r.max()))
        w = 1 / np.sqrt(1 + np.square(e / scale))
        H = (d / h[:, None])[:, :dims]
        step = np.linalg.lstsq(H * w[:, None], e * w, rcond=1e-4)[0]
        length = np.linalg.norm(step)
        l[:dims] += step * min(1.0, float(np.median(h)) / max(float(length), 1e-12))
        if length < 1e-9 * float(r.max()):
            break
    return l
