r"""Outlines of the ellipses that hold a position of the plane with a given probability.

    {r U sqrt(s) (cos a, sin a)'},   Sigma = U diag(s) U',   r^2 = -2 ln(1 - p)

r^2 is the quantile p of a chi-square variable with two degrees of freedom, in closed form: 5.99 for 95 %.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array

__all__ = ["outlines"]

CORNERS = 48  # the last is the first


def outlines(Sigma: Array, probability: float = 0.95) -> Array:
    """Outlines (n, 48, 2) around the origin of covariances (n, 2, 2), closed, in the unit of their roots.

    Examples
    --------
    >>> largest = outlines(np.array([[[4.0, 0.0], [0.0, 1.0]]]), 0.5).max(axis=1)
    >>> (largest / np.sqrt(2 * np.log(2))).round(2)
    array([[2., 1.]])
    """
    a = np.linspace(0, 2 * np.pi, CORNERS)
    a[-1] = 0.0
    U, s, _ = np.linalg.svd(Sigma)  # of a covariance: its eigenvectors and eigenvalues
    axes = np.sqrt(-2 * np.log1p(-probability)) * U * np.sqrt(s)[:, None, :]
    return np.asarray((axes @ np.stack([np.cos(a), np.sin(a)])).mT)
