r"""Where a ray meets a range: a point from the bearing of a camera and the distance a sonar beside it measured.

A camera at the origin sees a point along the unit bearing b; a sonar at s, in the frame of the camera, measures its
distance r. The point is d b, and the law of cosines in the triangle of camera, sonar and point,

    r^2 = d^2 + |s|^2 - 2 d (b.s),     d = b.s +- sqrt(D),     D = (b.s)^2 - |s|^2 + r^2

Only d > 0 is in front of the camera:

    r > |s|             one, the + root: the camera is inside the sphere of the range
    r < |s|, b.s > 0    two where D > 0: the ray goes in and comes out; none where D < 0: it passes the sphere
    r < |s|, b.s <= 0   none: the sphere is behind

r is measured, so D < 0 may be noise; the ray is then nearest to the sonar at d = b.s. With w = d - b.s = +-sqrt(D),

    dd/dr = r / w,     dd/db = d s' / w,     dd/ds = (d b - s)' / w
    p = d b,     dp/dr = b dd/dr,     dp/db = d I + b dd/db,     dp/ds = b dd/ds

where w = 0, the ray touching the sphere, the derivatives have no value. No arc cosine is needed, and s = 0 gives d = r.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask, Numbers, dot, product
from models.errors import GraphError
from models.finite import finite
from models.sensors.singular import CLOSE, refuse

__all__ = ["RayRange", "ray_range"]


class RayRange(NamedTuple):
    """Where n rays meet the spheres of n ranges; made by `ray_range`.

    Attributes
    ----------
    b : (n, 3) unit bearings.
    s : (n, 3) origins of the sonar in the frame of the camera, m.
    r : (n,) ranges, m.
    discriminant : (n,) D, m^2.
    depth : (2, n) d, m, of the far root and of the near one; nan where there is no such root in front of the camera.
    roots : (n,) how many are in front: 0, 1 or 2.
    """

    b: Array
    s: Array
    r: Array
    discriminant: Array
    depth: Array
    roots: Numbers

    @property
    def points(self) -> Array:
        """p = d b (2, n, 3), m, in the frame of the camera; nan where there is none."""
        return np.asarray(self.depth[..., None] * self.b)

    @property
    def missed(self) -> Mask:
        """(n,) the ray passes the sphere, D < 0: range or bearing are off."""
        return np.asarray(self.discriminant < 0)

    @property
    def behind(self) -> Mask:
        """(n,) the line of the ray meets the sphere, but not in front of the camera."""
        return np.asarray((self.roots == 0) & ~self.missed)

    @property
    def closest(self) -> Array:
        """(n,) depth b.s, m, at which the line of the ray is nearest to the sonar: the least bad answer if `missed`."""
        return dot(self.b, self.s)

    def jacobians(self, near: bool | Mask = False) -> tuple[Array, Array, Array]:
        """Derivatives of the points: dp/db (n, 3, 3), dp/dr (n, 3, 1) and dp/ds (n, 3, 3).

        Parameters
        ----------
        near : of the near root instead of the far one; one for all, or (n,).

        Raises
        ------
        SingularAt
            There is no such root, or the ray touches the sphere.
        """
        b, d = self.b, np.where(near, self.depth[1], self.depth[0])
        w, p = d - self.closest, d[:, None] * b
        refuse(
            ~(np.abs(w) > CLOSE),
            "there is no such point in front of the camera, or the ray only touches the sphere of the range and its "
            "derivative has no value; see `roots`",
        )
        along = (b / w[:, None])[:, :, None]
        p_b = d[:, None, None] * np.eye(3) + along * (d[:, None] * self.s)[:, None, :]
        return p_b, along * self.r[:, None, None], along * (p - self.s)[:, None, :]

    def covariance(
        self,
        J_b: Array,
        Sigma_z: npt.ArrayLike,
        sigma_r: npt.ArrayLike,
        Sigma_s: npt.ArrayLike | None = None,
        near: bool | Mask = False,
    ) -> Array:
        """Covariance of the points (n, 3, 3), m^2, in the frame of the camera, to first order.

        Parameters
        ----------
        J_b : (n, 3, 2) db/dz, as `Camera.ray` returns it.
        Sigma_z : (2, 2) or (n, 2, 2) covariance of the pixels.
        sigma_r : standard deviation of the ranges, m, one or (n,).
        Sigma_s : (3, 3) or (n, 3, 3) covariance of where the sonar is, m^2; known exactly when omitted. This part is
            common to all points: their errors are then correlated.
        near : as `jacobians`.

        Raises
        ------
        SingularAt
            As `jacobians`.

        Notes
        -----
        Near w = 0 the ray grazes the sphere, the point moves far for a small change of either, and first order is not
        enough.

        Examples
        --------
        A point 5 m ahead, known to 3 mm across and 2 cm along the ray:

        >>> import numpy as np
        >>> from models.sensors import Camera
        >>> b, J_b = Camera(focal=(600.0, 600.0)).ray([[0.0, 0.0]])
        >>> found = ray_range(b, [0.0, 0.2, 0.0], [5.0])
        >>> np.sqrt(np.diagonal(found.covariance(J_b, 0.4**2 * np.eye(2), 0.02)[0])).round(4)
        array([0.0033, 0.0033, 0.02  ])
        """
        p_b, p_r, p_s = self.jacobians(near)
        p_z = product(p_b, J_b)
        sigma_r = np.broadcast_to(np.asarray(sigma_r, dtype=float), len(self.r))
        Sigma = product(product(p_z, np.asarray(Sigma_z, dtype=float)), p_z.mT)
        Sigma = Sigma + product(p_r, p_r.mT) * np.square(sigma_r)[:, None, None]
        if Sigma_s is not None:
            Sigma = Sigma + product(product(p_s, np.asarray(Sigma_s, dtype=float)), p_s.mT)
        return np.asarray((Sigma + Sigma.mT) / 2)


def ray_range(b: npt.ArrayLike, s: npt.ArrayLike, r: npt.ArrayLike) -> RayRange:
    """Where rays from a camera meet ranges from a sonar beside it: both roots, and how many are in front.

    Parameters
    ----------
    b : (n, 3) unit bearings in the frame of the camera.
    s : (3,) or (n, 3) origin of the sonar in that frame, m: the translation of its pose on the camera.
    r : (n,) ranges, m.

    Returns
    -------
    RayRange

    Raises
    ------
    GraphError
        Wrong shapes, numbers that are not finite, bearings not of length 1, ranges below 0.

    Examples
    --------
    Both roots, one, and none: a ray through the sphere, one from inside, one that passes it:

    >>> ahead = [[0.0, 0.0, 1.0]] * 3
    >>> found = ray_range(ahead, [[0, 0, 5], [0, 0, 1], [0, 3, 5]], [1.0, 4.0, 2.0])
    >>> found.roots, found.depth
    (array([2, 1, 0]), array([[ 6.,  5., nan], [ 4., nan, nan]]))
    >>> found.missed, float(found.closest[2])
    (array([False, False,  True]), 5.0)
    """
    b, s, r = (finite("ray_range", name, X) for name, X in (("b", b), ("s", s), ("r", r)))
    n = len(b) if b.ndim else 0
    if b.shape != (n, 3) or s.shape not in ((3,), (1, 3), (n, 3)) or r.shape != (n,):
        raise GraphError(
            f"ray_range: b, s, r have shapes {b.shape}, {s.shape}, {r.shape}; expected (n, 3), (3,) or (n, 3), (n,)"
        )
    if (wrong := np.abs(dot(b, b) - 1) > NOT_UNIT).any():
        k = int(np.argmax(wrong))
        raise GraphError(f"ray_range: b[{k}] has length {np.linalg.norm(b[k]):.6g}, expected 1; divide it by that")
    if (r < 0).any():
        k = int(np.argmax(r < 0))
        raise GraphError(f"ray_range: r[{k}] is {r[k]:g} m; no range is below 0. Leave out what was not received")
    s = np.broadcast_to(s, (n, 3))
    along = dot(b, s)
    D = along * along - dot(s, s) + r * r
    half = np.sqrt(np.where(D >= 0, D, np.nan))
    far, near = along + half, along - half
    depth = np.stack([np.where(far > 0, far, np.nan), np.where((near > 0) & (half > 0), near, np.nan)])
    return RayRange(b, s, r, D, depth, np.isfinite(depth).sum(axis=0))


NOT_UNIT = 1e-6  # of |b|^2: what is farther off was not divided by its length
