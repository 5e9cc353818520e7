r"""Two points that may be one: nearer than their uncertainty, and never seen from the same pose.

d = l_a - l_b,   t = d' (P_aa + P_bb - P_ab - P_ba)^-1 d  ~  chi2    if they are the same point
"""

from __future__ import annotations

import numpy as np

from factors import Sighting
from factors.keys import Keys
from models import R
from models.advice import Advice
from models.algebra import Index
from nls.analysis.chi_squared import chi2_gate
from nls.analysis.linearization import Checked
from nls.explanation.findings import Finding, FindingKind
from nls.sparse.pattern import Pattern
from nls.values import Values

PAIRS = 20  # nearest pairs that are looked at
SAME = 0.999  # of such pairs that are one point are found
SPACING = 0.25  # of the usual distance to the next point: sigmas above that make neighbors of any two


def duplicate_points(checked: Checked, pattern: Pattern, values: Values) -> list[Finding]:
    """Pairs of points that the data cannot tell apart, by kind.

    Parameters
    ----------
    checked : of a graph in which nothing is free.
    pattern : with the gauge held.
    """
    out = []
    for name, stack in values.stacks.items():
        points = pattern.offsets[name] + np.arange(len(stack))
        points = points[~pattern.held[points]]
        if stack.manifold not in (R(2), R(3)) or len(points) < 3:
            continue
        for a, b, distance, sigmas in _nearest(checked, pattern, values, name, points, _poses(pattern, points)):
            numbers = {"distance": distance, "sigmas": sigmas}
            out.append(Finding(FindingKind.TWINS, (pattern.key(a), pattern.key(b)), numbers, (Advice("merge"),)))
    return out


def _poses(pattern: Pattern, points: Index) -> dict[int, set[int]]:
    """From which variables each point is seen."""
    poses: dict[int, set[int]] = {int(v): set() for v in points}
    for batch in pattern.batches:
        if isinstance(batch.model.factor, Sighting):
            mask = np.isin(batch.variables[1], points)
            for v, pose in zip(batch.variables[1][mask].tolist(), batch.variables[0][mask].tolist(), strict=True):
                poses[v].add(pose)
    return poses


def _nearest(
    checked: Checked, pattern: Pattern, values: Values, name: str, points: Index, poses: dict[int, set[int]]
) -> list[tuple[int, int, float, float]]:
    """Pairs of points (a, b) never seen together, how far apart and in how many sigmas, where that is no difference."""
    from scipy.spatial import cKDTree

    p = values[Keys(name, pattern.numbers[name][points - pattern.offsets[name]])]
    d = p.shape[1]
    distance, neighbor = cKDTree(p).query(p, k=2)
    spacing, ids = float(np.quantile(distance[:, 1], 0.75)), points.tolist()  # of most: twins are near each other
    near = {(float(distance[i, 1]), min(i, j), max(i, j)) for i, j in enumerate(neighbor[:, 1].tolist()) if i != j}
    apart = [pair for pair in sorted(near) if _never_together(poses[ids[pair[1]]], poses[ids[pair[2]]])][:PAIRS]
    out: list[tuple[int, int, float, float]] = []
    if not apart:
        return out
    involved = np.unique([pair[1:] for pair in apart])
    columns = pattern.starts[points[involved], None] + np.arange(d)  # (q, d)
    E = np.zeros((pattern.n, columns.size))
    E[columns.reshape(-1), np.arange(columns.size)] = 1.0
    P = checked.factorization.solve(E)[columns.reshape(-1)].reshape(len(involved), d, len(involved), d)
    for r, i, j in apart:
        a, b = np.searchsorted(involved, [i, j])
        Sigma = P[a, :, a] + P[b, :, b] - P[a, :, b] - P[b, :, a]
        if np.sqrt(np.trace(Sigma)) < SPACING * spacing and np.linalg.matrix_rank(Sigma, hermitian=True) == d:
            t = float((p[i] - p[j]) @ np.linalg.solve(Sigma, p[i] - p[j]))
            if t < chi2_gate(d, SAME):
                out.append((ids[i], ids[j], r, t**0.5))
    return out


def _never_together(a: set[int], b: set[int]) -> bool:
    return bool(a) and bool(b) and not a & b
