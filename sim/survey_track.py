r"""The way of a survey at any time: a lawn mower between two dives, over the ground, with small motions of the vehicle.

The way over the ground is a function of the distance s made good in the horizontal, s that of time,

    chi(s)   course: straight legs, half turns between them             p(s) = int (cos chi, sin chi) ds
    z(s)     depth: the surface, a dive, another depth in every turn, the surface
    s(t) = int U dt,   U = speed (1 + small motions)

Turns and dives follow q(u) = u^3 (10 - 15 u + 6 u^2), which begins and ends without speed and acceleration. The bow
points where the vehicle must steer in the current c to make the course good, and its pitch is that of the way:

    yaw = direction of U (cos chi, sin chi) - c,   pitch = atan(-z' U / U),   + small motions

Small motions are cubic splines through random knots. Everything is smooth, so velocities and rates are derivatives of
the same functions.
"""

from __future__ import annotations

from math import ceil, radians
from typing import TYPE_CHECKING

import numpy as np

from models import SO3, euler
from models.algebra import Array, apply, pack, wrap
from models.errors import OptionError
from models.manifolds.so3 import rotation3

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["TrueTrack"]

MARGIN = 30.0  # s of way before the first and after the last measurement
GRID = 0.25  # m between the knots of the course
KNOTS = 4.0  # s between those of the small motions
SWAY = {"speed": 0.02, "roll": radians(1.5), "pitch": radians(0.7), "yaw": radians(1.0)}  # their size; a fraction, rad
CURRENT = np.array([0.06, 0.08])  # m/s north and east
AT_SURFACE, SLOPE, STEP = 45.0, 8.0, 2.5  # m of way at the surface, m of way for a meter down, m of depth leg to leg
AFLOAT = 0.2  # m: depth of the center of a vehicle at the surface
LONGEST = 48 * 3600.0  # s: such a survey takes 0.7 GB, and 1.9 GB with its files
DIFFERENCE = 1e-3  # s: of the rates of the attitude


def eased(u: Array) -> Array:
    """From 0 to 1 while u does, at rest at both ends.

    Examples
    --------
    >>> eased(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]))
    array([0. , 0. , 0.5, 1. , 1. ])
    """
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u**3 * (10 - 15 * u + 6 * u * u))


def spline(x: Array, y: Array) -> CubicSpline:
    """The cubic spline through y (n, ...) at rising x (n,)."""
    from scipy.interpolate import CubicSpline  # 0.4 s, which other worlds need not wait for

    return CubicSpline(x, y)


class TrueTrack:
    """Where the vehicle is, and how it moves, at any time of a survey.

    Parameters
    ----------
    rng : source of the small motions.
    legs : how many, at least 1.
    leg, spacing : length of one and the distance to the next, m.
    depth : of the survey, m; every other leg is 2.5 m deeper.
    speed : over the ground, m/s.

    Attributes
    ----------
    duration : from the first measurement to the last, whole seconds.
    size : (2,) meters north and east that the legs cover.

    Raises
    ------
    OptionError
        A survey that takes more than two days.
    """

    def __init__(
        self, rng: np.random.Generator, legs: int, leg: float, spacing: float, depth: float, speed: float
    ) -> None:
        u = np.linspace(0.0, 1.0, 2001)
        turn = spacing / float(np.trapezoid(np.sin(np.pi * eased(u)), u))  # m of way of a half turn that is so wide
        dive = SLOPE * depth
        first = AT_SURFACE + dive
        self._turns = first + leg + (leg + turn) * np.arange(legs - 1)  # where they begin
        self._turn, self._dive, self._depth = turn, dive, depth
        self._rise = first + legs * leg + (legs - 1) * turn
        self._end = self._rise + dive + AT_SURFACE
        self.size = np.array([leg, (legs - 1) * spacing])
        if not (seconds := self._end / speed) <= LONGEST:
            allowed = f"a length with which the survey takes at most {LONGEST / 3600:g} h, not {seconds / 3600:.3g} h"
            raise OptionError("leg", leg, f"{allowed}, or fewer legs")
        self.duration = int(seconds)
        tail = MARGIN * speed
        s = np.arange(-tail, self._end + 2 * tail, GRID)
        self._tangent = spline(s, np.column_stack([np.cos(self._course(s)), np.sin(self._course(s))]))
        self._way = self._tangent.antiderivative()
        self._offset = self._way(first)  # the first leg begins at 0, 0
        t = np.arange(-MARGIN - KNOTS, self.duration + MARGIN + 2 * KNOTS, KNOTS)
        self._speed = spline(t, speed * (1 + SWAY["speed"] * rng.standard_normal(len(t))))
        self._distance = self._speed.antiderivative()
        self._start = self._distance(0.0)
        self._sway = spline(t, rng.standard_normal((len(t), 3)) * [SWAY[name] for name in ("roll", "pitch", "yaw")])

    def _turned(self, s: Array, amount: float) -> Array:
        """The amount of one turn (n,) after the ways (n,): every other turn takes it back."""
        begun = np.searchsorted(self._turns, s, side="right")
        begin = np.concatenate([[-np.inf], self._turns])[begun]
        last = amount * eased((s - begin) / self._turn)
        return np.asarray(np.where(begun % 2, last, amount - last))

    def _course(self, s: Array) -> Array:
        return self._turned(s, np.pi)

    def _down(self, s: Array) -> Array:
        """Depths (n,) after the ways (n,)."""
        last = STEP * (len(self._turns) % 2) + self._depth
        dived, risen = eased((s - AT_SURFACE) / self._dive), eased((s - self._rise) / self._dive)
        return np.asarray(AFLOAT + (self._depth * dived + self._turned(s, STEP) - last * risen))

    def _made_good(self, t: Array) -> Array:
        return np.asarray(self._distance(t) - self._start)

    def surfaced(self, t: Array) -> Array:
        """Whether (n,) the vehicle is at the surface at times (n,), s."""
        s = self._made_good(t)
        return np.asarray((s < AT_SURFACE) | (s > self._rise + self._dive))

    def position(self, t: Array) -> Array:
        """North, east and down (n, 3), m, at times (n,), s."""
        s = self._made_good(t)
        return np.column_stack([self._way(s) - self._offset, self._down(s)])

    def attitude(self, t: Array) -> Array:
        """Roll, pitch and yaw (n, 3), rad, at times (n,), s; the yaw goes on beyond pi."""
        s, U = self._made_good(t), self._speed(t)
        chi, h = self._course(s), 1e-3
        slope = (self._down(s + h) - self._down(s - h)) / (2 * h)
        c, d = np.cos(chi), np.sin(chi)
        ahead, aside = U - c * CURRENT[0] - d * CURRENT[1], d * CURRENT[0] - c * CURRENT[1]
        level = np.column_stack([np.zeros_like(s), np.arctan(-slope), chi + np.arctan2(aside, ahead)])
        return np.asarray(level + self._sway(t))

    def pose(self, t: Array) -> Array:
        """Poses (n, 7), SE3, at times (n,), s."""
        rpy = self.attitude(t)
        rpy[:, 2] = wrap(rpy[:, 2])
        return euler.to_se3(np.column_stack([rpy, self.position(t)]))

    def velocity(self, t: Array) -> tuple[Array, Array]:
        """Velocity over the ground (n, 3), m/s, and rate (n, 3), rad/s, in body axes, at times (n,), s."""
        s, U, h = self._made_good(t), self._speed(t), DIFFERENCE
        slope = (self._down(s + h) - self._down(s - h)) / (2 * h)
        rpy = self.attitude(t)
        over_ground = np.column_stack([self._tangent(s), slope]) * U[:, None]
        to_body = SO3.inverse(euler.quaternion_from_angles(rpy))
        rates = (self.attitude(t + h) - self.attitude(t - h)) / (2 * h)
        return apply(rotation3(to_body), over_ground), apply(euler.rate_matrix(rpy), rates)


def every(period: float, begin: float, end: float) -> Array:
    """Times (n,) from begin to end, both included where they fall on the period, s.

    Examples
    --------
    >>> every(0.25, 0.0, 1.0)
    array([0.  , 0.25, 0.5 , 0.75, 1.  ])
    """
    return np.round(begin + period * np.arange(ceil((end - begin) / period - 1e-9) + 1), 9)


def sounded(xy: Array) -> Array:
    """Depth of the bottom (n,), m, at north and east (n, 2), m: waves of some meters.

    Examples
    --------
    >>> sounded(np.zeros((1, 2)))
    array([41.])
    """
    x, y = xy.T
    return np.asarray(38.0 + 4.0 * np.sin(x / 60.0 + y / 110.0) + 3.0 * np.cos(y / 45.0))


def wandering(rng: np.random.Generator, t: Array, size: float, knots: float) -> Array:
    """A slow error (n,) of this standard deviation at rising times t (n,), a spline with a knot every so many s."""
    grid = np.arange(t[0] - knots, t[-1] + 2 * knots, knots)
    return np.asarray(size * spline(grid, rng.standard_normal(len(grid)))(t))


def ship_pose(t: Array, anchor: Array) -> Array:
    """Roll, pitch, yaw, x, y and z (n, 6) of the transceiver of a ship that swings on its anchor (2,) at times (n,)."""
    swing = 2 * np.pi * t
    return pack(
        [
            radians(1.0) * np.sin(swing / 9.0),
            radians(0.5) * np.sin(swing / 7.0 + 1.0),
            radians(40.0) + radians(8.0) * np.sin(swing / 240.0),
            anchor[0] + 4.0 * np.sin(swing / 310.0),
            anchor[1] + 6.0 * np.sin(swing / 240.0 + 0.5),
            np.full_like(t, 3.0),
        ]
    )
