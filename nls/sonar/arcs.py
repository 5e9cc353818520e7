r"""Where on their arcs are the points of two sonar images? What the search on either side of el = 0 comes to.

`models.sensors.arcs` searches each side of the plane el = 0 by itself. What comes out of the two says which case a
point is:

- *measured*: one side is clearly better, or the minimum lies at 0 itself
- *ambiguous*: a minimum on either side, and their chi2 differ by less than `ALIKE`; both are kept, never averaged
- *weak*: the two views say less about the elevation than the aperture does, an even spread over 2 limit. Both sides are
  kept, at +-limit / sqrt(3), which has the mean and the variance of that spread
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Mask, gram
from models.errors import SingularGeometryError
from models.sensors.arcs import Contacts, least_information
from models.sensors.singular import SingularAt

__all__ = ["search"]


ALIKE = 4.0  # chi2: a mirror image within 2 sigmas of the better one is as good


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
    try:
        h, chi2 = contacts.sides(G)
    except SingularAt as error:
        r, az = contacts.z[error.index, :2]
        raise SingularGeometryError(
            f"the contact at {r:g} m, {az:g} rad, seen from the second view: {error}"
        ) from error
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
        moved, spread_chi2, _ = few.fit(G, few.fit(G, spread.reshape(-1, 3))[0])
        h[:, weak], chi2[:, weak] = moved.reshape(spread.shape), spread_chi2.reshape(2, -1)
    return Arcs(h, chi2, ambiguous, weak, lowest, (size[0] > (1 - 1e-4) * limit) & ~(ambiguous | weak))
