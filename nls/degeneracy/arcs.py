r"""Where on their arcs are the points of two sonar images? A one-dimensional search for each, given the motion between.

    chi2(el) = min over (r, az) of |z_i - (r, az)|^2_R + |z_j - h_j(r, az, el; G)|^2_R,      |el| <= limit

The search runs on each side of the plane el = 0 by itself. It has to: motions in that plane (surge, sway, yaw) give el
and -el the same chi2, and at el = 0 its derivative vanishes, so that a descent from there never leaves the plane. What
comes out of the two sides says which case a point is:

- *measured*: one side is clearly better, or the minimum lies at 0 itself
- *ambiguous*: a minimum on either side, and their chi2 differ by less than `ALIKE`; both are kept, never averaged
- *weak*: the two views say less about the elevation than the aperture does, an even spread over 2 limit: both sides
  are kept, at +-limit / sqrt(3), which has the mean and the variance of that spread
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.algebra import Array, dot, gram, wrap
from models.errors import SingularGeometryError
from models.sensors import SingularAt
from nls.degeneracy.views import second_view

__all__ = ["Arcs", "Contacts", "search"]

Mask = npt.NDArray[np.bool_]

ALIKE = 4.0  # chi2: a mirror image within 2 sigmas of the better one is as good
NODES, ROUNDS = 33, 6  # a round narrows an interval to a sixteenth: 7 deg to 4e-7 deg


@dataclass(frozen=True)
class Contacts:
    """m points in two images: z_i, z_j and sigma (m, 2), range and azimuth, m and rad; limit of |elevation|, rad."""

    z_i: Array
    z_j: Array
    sigma: Array
    limit: float

    def __len__(self) -> int:
        return len(self.z_i)

    def linearize(self, G: Array, h: Array) -> tuple[Array, Array, Array]:
        """Whitened A_G (m, 4, 6), A_l (m, 4, 3) and b (m, 4) of both views of points h (m, 3).

        The columns of A_l are the directions of (r, az, el) at the point, in meters along them.
        """
        z, (H_G, H_h) = second_view(G, h)
        e = np.concatenate([self.z_i - h[:, :2], self.z_j - z], axis=1)
        e[:, [1, 3]] = wrap(e[:, [1, 3]])
        W = 1 / np.concatenate([self.sigma, self.sigma], axis=1)
        r, _, el = h.T
        H_l = np.concatenate([np.broadcast_to(np.eye(2, 3), H_h.shape), H_h], axis=1)
        H_l = H_l / np.stack([np.ones_like(r), r * np.cos(el), r], axis=1)[:, None, :]
        H_G = np.concatenate([np.zeros_like(H_G), H_G], axis=1)
        return W[:, :, None] * H_G, W[:, :, None] * H_l, W * e

    def rows(self, index: npt.NDArray[np.intp]) -> Contacts:
        """Some of the points, or each several times."""
        return Contacts(self.z_i[index], self.z_j[index], self.sigma[index], self.limit)

    def fit(self, G: Array, h: Array) -> tuple[Array, Array]:
        """One Gauss-Newton step for (r, az) of points h (m, 3), and the chi2 (m,) it leads to.

        The first view all but determines them: from there the first step is within 1e-3 sigma.
        """
        try:
            _, A_l, b = self.linearize(G, h)
        except SingularAt as error:
            r, az = self.z_i[error.index]
            raise SingularGeometryError(
                f"the contact at {r:g} m, {az:g} rad, seen from the second view: {error}"
            ) from error
        A_r, A_az = A_l[:, :, 0], A_l[:, :, 1]
        p, q, s, u, v = dot(A_r, A_r), dot(A_r, A_az), dot(A_az, A_az), dot(A_r, b), dot(A_az, b)
        dx = np.stack([s * u - q * v, p * v - q * u], axis=1) / (p * s - q * q)[:, None]  # m along r and az
        moved = h + np.column_stack([dx[:, 0], dx[:, 1] / (h[:, 0] * np.cos(h[:, 2])), np.zeros(len(h))])
        return moved, dot(b, b) - u * dx[:, 0] - v * dx[:, 1]


@dataclass(frozen=True)
class Arcs:
    """Where the points are, one hypothesis on each side of the plane el = 0, the better one first.

    Attributes
    ----------
    h : (2, m, 3) range, azimuth, elevation.
    chi2 : (2, m) of the four measurements of a point.
    two : (m,) whether both count: ambiguous or weak. Elsewhere the second is only what the other side had to offer.
    ambiguous, weak : (m,) why.
    lowest : (m,) chi2 at the best elevation there is.
    at_limit : (m,) whether that is at the end of the aperture.
    """

    h: Array
    chi2: Array
    ambiguous: Mask
    weak: Mask
    lowest: Array
    at_limit: Mask

    @property
    def two(self) -> Mask:
        return self.ambiguous | self.weak


def search(contacts: Contacts, G: Array, like: Arcs | None = None) -> Arcs:
    """The elevations of lowest chi2 on either side.

    Parameters
    ----------
    contacts : the two images.
    G : (1, 7) motion of the sonar.
    like : where it is decided already which points are ambiguous, and which weak.
    """
    m, limit = len(contacts), contacts.limit
    lo, hi = np.repeat([-limit, 0.0], m), np.repeat([0.0, limit], m)  # above the plane of the sonar, and below it
    u, both = np.linspace(0, 1, NODES), contacts.rows(np.tile(np.arange(m), 2))
    every, at = both.rows(np.repeat(np.arange(2 * m), NODES)), np.arange(2 * m)
    h = np.column_stack([both.z_i, lo])
    for _ in range(ROUNDS):
        el = lo[:, None] + (hi - lo)[:, None] * u  # (2 m, NODES)
        tried, chi2 = every.fit(G, np.column_stack([np.repeat(h[:, :2], NODES, axis=0), el.reshape(-1)]))
        k = chi2.reshape(el.shape).argmin(axis=1)
        h = tried.reshape(*el.shape, 3)[at, k]
        lo, hi = el[at, np.maximum(k - 1, 0)], el[at, np.minimum(k + 1, NODES - 1)]
    h, chi2 = (x.reshape(2, m, *x.shape[1:]) for x in both.fit(G, h))
    better = chi2.argmin(axis=0)
    order, points = np.stack([better, 1 - better]), np.arange(m)
    h, chi2 = h[order, points], chi2[order, points]
    size, lowest = np.abs(h[:, :, 2]), chi2[0].copy()
    if like is None:
        _, A_l, _ = contacts.linearize(G, h[0])
        weak = np.linalg.eigvalsh(gram(A_l))[:, 0] <= least_information(contacts)
        ambiguous = (chi2[1] - chi2[0] < ALIKE) & (size > 1e-4 * limit).all(axis=0) & ~weak
    else:
        ambiguous, weak = like.ambiguous, like.weak
    if weak.any():
        spread = h[:, weak].copy()
        spread[:, :, 2] = [[-limit / np.sqrt(3)], [limit / np.sqrt(3)]]
        few = contacts.rows(np.tile(np.flatnonzero(weak), 2))
        moved, spread_chi2 = few.fit(G, few.fit(G, spread.reshape(-1, 3))[0])
        h[:, weak], chi2[:, weak] = moved.reshape(spread.shape), spread_chi2.reshape(2, -1)
    return Arcs(h, chi2, ambiguous, weak, lowest, (size[0] > (1 - 1e-4) * limit) & ~(ambiguous | weak))


def least_information(contacts: Contacts) -> Array:
    """Information (m,) about the elevation that the aperture alone gives, 1/m^2: 1 / (r limit / sqrt(3))^2."""
    return np.asarray(3 / np.square(contacts.z_i[:, 0] * contacts.limit))
