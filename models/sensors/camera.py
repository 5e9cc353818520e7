r"""A pinhole camera with the distortion of its lens. Camera axes: x right, y down, z forward.

    m = (X, Y) / Z                                   normalized coordinates of p = (X, Y, Z); only for Z > 0
    s = m'm,   g = 1 + k1 s + k2 s^2 + k3 s^3        radial,   q = (p2, p1) decentering
    d = g m + s q + 2 (q'm) m
    h = f d + c                                      f = diag(fx, fy), pixels

    dm/dp = [I, -m] / Z
    D = dd/dm = (g + 2 q'm) I + 2 g' m m' + 2 (q m' + m q'),   g' = dg/ds,   dh/dp = f D dm/dp

-p has the same m as p: without the test of Z a point behind the camera would have a mirrored image.

The way back, from a pixel to a ray, solves d(m) = f^-1 (h - c) by Newton's method. D is symmetric, so d is a gradient.
Its least eigenvalue is at least min(g, g + 2 s g') - 6 |q| sqrt(s); up to the first zero of that, `Camera.reach`, d is
the gradient of a strictly convex function and no two points share an image. Beyond, the image of a barrel distortion
folds back onto itself, and a pixel says nothing about its ray.

Source: D. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32(3), 1966; the order k1 k2 p1 p2 k3
is that of OpenCV's calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask, components, dot, matrix, pack, product
from models.errors import GraphError, OptionError
from models.options import is_number, is_whole
from models.sensors.singular import refuse

__all__ = ["Camera"]

GRAZING = 1e-9  # Z over |X| or |Y| below this: 1e9 focal lengths from the middle of the image
EXACT = 1e-12  # of normalized coordinates, to which distortion is undone: with 1e4 pixels of focal length 1e-8 pixels
STEPS = 100  # of Newton's method, halvings included; wide-angle images, corners included, take 5 to 7


@dataclass(frozen=True)
class Camera:
    """A camera by its calibration; without numbers it measures normalized coordinates X/Z and Y/Z.

    Parameters
    ----------
    focal : focal lengths (fx, fy), pixels.
    center : where the optical axis meets the image, pixels.
    distortion : (k1, k2, p1, p2, k3) of the lens, what is left out is 0; the factors of Brown's polynomial, no units.
    size : (width, height) of the image, pixels; what is visible is then within 0 to width and 0 to height.

    Raises
    ------
    OptionError
        A number no camera can have.

    Examples
    --------
    >>> import numpy as np
    >>> camera = Camera(focal=(600.0, 600.0), center=(640.0, 480.0), distortion=(-0.2,), size=(1280, 960))
    >>> h, _ = camera.project(np.array([[0.5, 0.0, 2.0]]))
    >>> h, round(camera.reach, 3)
    (array([[788.125, 480.   ]]), 1.291)
    >>> b, _ = camera.ray(h)
    >>> (b / b[:, 2:]).round(6)
    array([[0.25, 0.  , 1.  ]])
    """

    focal: tuple[float, float] = (1.0, 1.0)
    center: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, ...] = ()
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        focal, size = self.focal, self.size
        for option, good, allowed in (
            ("focal", _numbers(focal, 2) and min(focal) > 0, "focal lengths (fx, fy) above 0, pixels"),
            ("center", _numbers(self.center, 2), "the principal point (cx, cy), pixels"),
            ("distortion", _numbers(self.distortion, *range(6)), "up to five numbers, k1 k2 p1 p2 k3"),
            (
                "size",
                size is None or (_numbers(size, 2) and all(is_whole(k) and k > 0 for k in size)),
                "whole numbers (width, height) of at least 1, pixels, or None",
            ),
        ):
            if not good:
                raise OptionError(f"Camera: {option}", getattr(self, option), allowed)
            if getattr(self, option) is not None:
                object.__setattr__(self, option, tuple(getattr(self, option)))

    @property
    def _brown(self) -> tuple[float, float, float, Array]:
        """k1, k2, k3 and q = (p2, p1)."""
        k1, k2, p1, p2, k3 = (*self.distortion, *[0.0] * (5 - len(self.distortion)))
        return k1, k2, k3, np.array([p2, p1])

    @cached_property
    def reach(self) -> float:
        """|m| up to which the distortion can be undone: the tangent of an angle from the axis, infinite without it."""
        k1, k2, k3, q = self._brown
        tilt = -6 * float(np.hypot(*q))
        least = [np.roots([a * k3, 0, b * k2, 0, c * k1, tilt, 1]) for a, b, c in ((7, 5, 3), (1, 1, 1))]  # in sqrt(s)
        zeros = np.concatenate(least)
        # a double zero touches without crossing and comes out as a pair, 1e-8 off the real axis
        return float(np.min(zeros.real[(np.abs(zeros.imag) < 1e-6 * np.abs(zeros)) & (zeros.real > 0)], initial=np.inf))

    def project(self, p: Array) -> tuple[Array, Array]:
        """Image of points.

        Parameters
        ----------
        p : (n, 3) array, m, in the frame of the camera.

        Returns
        -------
        h : (n, 2) array, pixels (normalized coordinates for a camera without numbers), also outside of the image.
        J : (n, 2, 3) dh/dp, pixels per m.

        Raises
        ------
        SingularAt
            A point behind the camera or in its plane, Z <= 0.

        Notes
        -----
        Beyond `reach` the polynomial has a value, but no lens: `sees` says so.
        """
        X, Y, Z = components(p)
        refuse(
            _behind(X, Y, Z),
            "the point is behind the camera (Z <= 0) and has no image; check the initial values of pose and point",
        )
        x, y = X / Z, Y / Z
        f, m, m_p = np.array(self.focal), pack([x, y]), matrix([[1 / Z, 0.0, -x / Z], [0.0, 1 / Z, -y / Z]])
        if not any(self.distortion):
            return f * m + self.center, f[:, None] * m_p
        d, D = self._distorted(m)
        return f * d + self.center, f[:, None] * product(D, m_p)

    def ray(self, z: npt.ArrayLike) -> tuple[Array, Array]:
        """Directions in which pixels look.

        Parameters
        ----------
        z : (n, 2) array, pixels.

        Returns
        -------
        b : (n, 3) unit vectors in the frame of the camera.
        J : (n, 3, 2) db/dz, per pixel.

        Raises
        ------
        GraphError
            Another shape.
        SingularAt
            A pixel that the image of no direction within `reach` hits.
        """
        z, f = np.asarray(z, dtype=float), np.array(self.focal)
        if z.ndim != 2 or z.shape[1] != 2:
            raise GraphError(f"Camera.ray: pixels have shape {z.shape}, expected (n, 2): one (u, v) per row")
        m, good = self._undistorted((z - self.center) / f)
        if not good.all():
            u, v = z[np.argmin(good)]
            widest = f"it can only be undone up to {np.degrees(np.arctan(self.reach)):.3g} deg from the axis"
            why = f"in the distortion {tuple(self.distortion)}; {widest}" if np.isfinite([u, v]).all() else "at all"
            refuse(~good, f"pixel ({u:.6g}, {v:.6g}) has no ray {why}. Leave the measurement out")
        x, y = components(m)
        length = np.sqrt(1 + x * x + y * y)
        b = pack([x / length, y / length, 1 / length])
        bx, by, bz = components(b)
        b_m = matrix([[1 - bx * bx, -bx * by], [-bx * by, 1 - by * by], [-bx * bz, -by * bz]]) / length[:, None, None]
        return b, product(b_m, _inverse(self._distorted(m)[1])) / f

    def sees(self, p: Array) -> Mask:
        """Which points p (n, 3), m, in the frame of the camera are in front, within `reach` and in the image, (n,).

        The edges of the image are inside; without `size` it has none. A point that is not finite is not seen.

        Examples
        --------
        >>> import numpy as np
        >>> camera = Camera((600.0, 600.0), (640.0, 480.0), size=(1280, 960))
        >>> camera.sees(np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [3.0, 0.0, 2.0]]))
        array([ True, False, False])
        """
        p = np.asarray(p, dtype=float)
        X, Y, Z = components(np.where(np.isfinite(p).all(axis=-1, keepdims=True), p, [0.0, 0.0, -1.0]))
        visible: Mask = np.logical_and(~_behind(X, Y, Z), np.hypot(X, Y) / self.reach < Z)
        if self.size is not None:
            h, _ = self.project(np.where(visible[:, None], p, [0.0, 0.0, 1.0]))
            visible &= ((h >= 0) & (h <= self.size)).all(axis=-1)
        return visible

    def _distorted(self, m: Array) -> tuple[Array, Array]:
        """d(m) (n, 2) and D (n, 2, 2)."""
        k1, k2, k3, q = self._brown
        x, y = components(m)
        qx, qy = q
        s, t = x * x + y * y, 2 * (qx * x + qy * y)
        g = 1 + s * (k1 + s * (k2 + s * k3)) + t  # with the part of the decentering along m
        slope = 2 * (k1 + s * (2 * k2 + 3 * k3 * s))
        across = slope * x * y + 2 * (qx * y + qy * x)
        D = matrix([[g + slope * x * x + 4 * qx * x, across], [across, g + slope * y * y + 4 * qy * y]])
        return pack([g * x + s * qx, g * y + s * qy]), D

    def _undistorted(self, d: Array) -> tuple[Array, Mask]:
        """m (n, 2) of which d is the image, and whether it was found.

        From the middle, where D is the identity; a step out of `reach`, or to a larger error, is halved.
        """
        if not any(self.distortion):
            return d, np.asarray(np.isfinite(d).all(axis=-1))
        m, e, t = np.zeros_like(d), d, np.ones(len(d))
        for _ in range(STEPS):
            done = dot(e, e) <= EXACT**2
            if done.all():
                break
            step = product(_inverse(self._distorted(m)[1]), e[..., None])[..., 0]
            trial = m + t[:, None] * step
            left = d - self._distorted(trial)[0]
            accepted = (dot(trial, trial) < self.reach**2) & (dot(left, left) < dot(e, e)) & ~done
            m, e = np.where(accepted[:, None], trial, m), np.where(accepted[:, None], left, e)
            t = np.where(accepted, np.minimum(2 * t, 1.0), t / 2)
        return m, np.asarray(dot(e, e) <= EXACT**2)


def _behind(X: Array, Y: Array, Z: Array) -> Mask:
    """Whether points are behind a camera, or as good as in its plane."""
    return np.asarray(Z <= GRAZING * np.maximum(np.abs(X), np.abs(Y)))


def _inverse(D: Array) -> Array:
    """Of symmetric matrices (n, 2, 2)."""
    a, b, c = D[..., 0, 0], D[..., 0, 1], D[..., 1, 1]
    return np.asarray(matrix([[c, -b], [-b, a]]) / (a * c - b * b)[..., None, None])


def _numbers(value: Any, *lengths: int) -> bool:
    """Whether a value is a sequence of so many finite numbers."""
    return isinstance(value, Sequence) and len(value) in lengths and all(is_number(v) and np.isfinite(v) for v in value)
