r"""A point seen in two sonar images: where on its arc is it? A search along one dimension, given the motion between.

    q = G^-1 p(r, az, el),   f = (r, az, |q|, atan2(q_y, q_x)),   G = S_i^-1 S_j      sonar j as seen from sonar i

    df_j/d(r, az, el) = J(q) R_G' dp/d(r, az, el)            df_j/ddelta = J(q) [-I, [q]x],   G <- G Exp(delta)

The third column of the first is all that is ever learned about the elevation. It vanishes for every elevation when the
sonar only yaws, and on the plane el = 0 for every motion in that plane (surge, sway, yaw). The search,

    chi2(el) = min over (r, az) of |W (z - f)|^2,      |el| <= limit,

runs on each side of el = 0 by itself. It has to: motions in the plane give el and -el the same chi2, and at el = 0 its
derivative vanishes, so that a descent from there never leaves the plane. On either side a grid finds the valley and the
zero of the slope its bottom, the bracket kept (regula falsi after Illinois: M. Dowell, P. Jarratt, BIT 11, 1971).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Index, apply, dot, product, wrap
from models.manifolds.se3 import SE3
from models.sensors.frame import point_in_frame
from models.sensors.singular import SingularAt, refuse
from models.sensors.spherical import cartesian, range_azimuth

__all__ = ["Contacts", "least_information", "second_view"]

NODES = 8  # of the grid on a side: an aperture of +-14 deg in steps of 1.8 deg
ROUNDS = 10  # of the regula falsi: 1e-9 sigma of slope is left where elevations are known to 0.1 deg
ALIKE = 1e-11  # of 1 + chi2, what rounding makes of it


def second_view(G: Array, h: Array) -> tuple[Array, tuple[Array, Array]]:
    """Measurements of the second view of points of the first.

    Parameters
    ----------
    G : (1 or n, 7) motion of the sonar, SE3.
    h : (n, 3) range, azimuth and elevation in the first view, m and rad.

    Returns
    -------
    z : (n, 2) range and azimuth in the second, m and rad.
    H_G, H_h : (n, 2, 6) and (n, 2, 3).

    Raises
    ------
    SingularAt
        A point on the z axis of the second sonar.

    Examples
    --------
    >>> import numpy as np
    >>> heave = np.array([[0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]])
    >>> z, (_, H_h) = second_view(heave, np.array([[4.0, 0.0, 0.0]]))
    >>> z.round(3), H_h[0, :, 2].round(3)  # 0.3 m down: of 1 rad of elevation 0.3 m of range
    (array([[4.011, 0.   ]]), array([-0.299,  0.   ]))
    """
    p, P = cartesian(h)
    q, (H_G, H_p) = point_in_frame(SE3, G, p)
    z, J = range_azimuth(q)
    return z, (product(J, H_G), product(J, product(H_p, P)))


@dataclass(frozen=True, eq=False)
class Contacts:
    """m points in two images.

    Attributes
    ----------
    z : (m, 4) range and azimuth in the first view, then in the second, m and rad.
    W : (1 or m, 4, 4) their whitener.
    limit : of |elevation| in the first view, rad.
    """

    z: Array
    W: Array
    limit: float

    def __len__(self) -> int:
        return len(self.z)

    def rows(self, index: Index) -> Contacts:
        """Some of the points, or each several times."""
        return Contacts(self.z[index], self.W if len(self.W) == 1 else self.W[index], self.limit)

    def innovation(self, G: Array, h: Array) -> tuple[Array, Array, Array]:
        """e = z - f (m, 4), H_G (m, 4, 6) and H_l (m, 4, 3) of points h (m, 3).

        The columns of H_l are the directions of (r, az, el) at the point, in meters along them.
        """
        z_j, (H_G, H_h) = second_view(G, h)
        e = self.z - np.concatenate([h[:, :2], z_j], axis=1)
        e[:, 1::2] = wrap(e[:, 1::2])
        H_l = np.concatenate([np.broadcast_to(np.eye(2, 3), H_h.shape), H_h], axis=1)
        return e, np.concatenate([np.zeros_like(H_G), H_G], axis=1), H_l / meters(h)[:, None, :]

    def linearize(self, G: Array, h: Array) -> tuple[Array, Array, Array]:
        """Whitened A_G (m, 4, 6), A_l (m, 4, 3) and b (m, 4) of both views of points h (m, 3)."""
        e, H_G, H_l = self.innovation(G, h)
        return product(self.W, H_G), product(self.W, H_l), apply(self.W, e)

    def fit(self, G: Array, h: Array) -> tuple[Array, Array, Array]:
        """One Gauss-Newton step for (r, az) of points h (m, 3), the chi2 (m,) it leads to, and half its slope in el.

        Starting at what the first view says, one step is within 1e-3 sigma of the best.

        Raises
        ------
        SingularAt
            A point on the z axis of the second sonar; noise that leaves range and azimuth open.
        """
        e, _, H_l = self.innovation(G, h)
        A_l, b = product(self.W, H_l), apply(self.W, e)
        A_r, A_az, A_el = A_l[:, :, 0], A_l[:, :, 1], A_l[:, :, 2]
        p, q, s, u, v = dot(A_r, A_r), dot(A_r, A_az), dot(A_az, A_az), dot(A_r, b), dot(A_az, b)
        det = p * s - q * q
        refuse(~(det > 1e-12 * p * s), "its noise says too little to give the point a range and an azimuth")
        dx = np.stack([s * u - q * v, p * v - q * u], axis=1) / det[:, None]  # m along r and az
        lengths = meters(h)
        moved = h + np.column_stack([dx / lengths[:, :2], np.zeros(len(h))])
        left = b - A_r * dx[:, :1] - A_az * dx[:, 1:]
        return moved, dot(left, left), -dot(A_el, left) * lengths[:, 2]

    def sides(self, G: Array) -> tuple[Array, Array]:
        """The points of lowest chi2 above the plane el = 0 and below it.

        Parameters
        ----------
        G : (1 or m, 7) motion of the sonar, SE3.

        Returns
        -------
        h : (2, m, 3) range, azimuth and elevation in [-limit, 0] and in [0, limit].
        chi2 : (2, m).

        Raises
        ------
        SingularAt
            As `fit`.
        """
        grid = np.linspace(-self.limit, self.limit, 2 * NODES + 1)
        near, fits = self.fit(G, np.insert(self.z[:, :2], 2, -self.limit, axis=1))[0], []
        for el in grid:
            near, chi2, _ = self.fit(G, at(el, near))
            fits.append((near, chi2))
        h, chi2 = (
            np.concatenate([nodes[: NODES + 1], nodes[NODES:]], axis=1)  # (nodes, 2 m), one side after the other
            for nodes in (np.stack([h for h, _ in fits]), np.stack([chi2 for _, chi2 in fits]))
        )
        twice, m = np.tile(np.arange(len(self)), 2), len(self)
        try:
            best, lowest = self.rows(twice)._bottom(G if len(G) == 1 else G[twice], h, chi2)
        except SingularAt as error:
            raise SingularAt(str(error), error.index % m) from None
        return best.reshape(2, m, 3), lowest.reshape(2, m)

    def best(self, G: Array) -> Array:
        """The points (m, 3) of lowest chi2; of those that fit alike the one on the plane el = 0, then that below it.

        All fit alike where the sonar only yaws, el and -el where it moves in its plane: rounding is not to choose.
        """
        (above, below), chi2 = self.sides(G)
        level = at(0.0, below)
        for _ in range(3):
            level, flat, _ = self.fit(G, level)
        lowest = chi2.min(axis=0)
        alike = lowest + ALIKE * (1 + lowest)
        return np.where((flat <= alike)[:, None], level, np.where((chi2[1] <= alike)[:, None], below, above))

    def _bottom(self, G: Array, h: Array, chi2: Array) -> tuple[Array, Array]:
        """The lowest point h (m, 3) and its chi2 (m,), from those on a grid (nodes, m, 3)."""
        k, points = chi2.argmin(axis=0), np.arange(len(self))
        best, lowest, _ = self.fit(G, h[k, points])
        lo, hi = h[np.maximum(k - 1, 0), points, 2], h[np.minimum(k + 1, len(h) - 1), points, 2]
        (_, _, g_lo), (_, _, g_hi) = (self.fit(G, self.fit(G, at(el, best))[0]) for el in (lo, hi))
        inside, last = (g_lo < 0) & (g_hi > 0), np.zeros(len(self))  # elsewhere the bottom is at an end
        lo, hi = np.where(inside, lo, np.where(g_lo >= 0, lo, hi)), np.where(inside | (g_lo < 0), hi, lo)
        for _ in range(ROUNDS):
            el = np.where(inside, (lo * g_hi - hi * g_lo) / np.where(inside, g_hi - g_lo, 1.0), lo)
            best, lowest, g = self.fit(G, at(el, best))
            side = np.where(g > 0, 1.0, -1.0)
            half = np.where(side == last, 0.5, 1.0)  # the same end twice: halve the slope at the other
            lo, g_lo, hi, g_hi = (
                np.where(g > 0, lo, el),
                np.where(g > 0, g_lo * half, g),
                np.where(g > 0, el, hi),
                np.where(g > 0, g, g_hi * half),
            )
            last = side
        return best, lowest


def at(el: npt.ArrayLike, h: Array) -> Array:
    """Points h (m, 3) at other elevations."""
    r, az, _ = h.T
    return np.stack(np.broadcast_arrays(r, az, el), axis=1)


def meters(h: Array) -> Array:
    """Length (m, 3) of a unit of r, az and el at points h (m, 3): 1, r cos(el) and r."""
    r, _, el = h.T
    return np.stack([np.ones_like(r), r * np.cos(el), r], axis=1)


def least_information(contacts: Contacts) -> Array:
    """Information (m,) about the elevation that the aperture alone gives, 1/m^2: 1 / (r limit / sqrt(3))^2."""
    return np.asarray(3 / np.square(contacts.z[:, 0] * contacts.limit))
