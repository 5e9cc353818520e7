r"""A scene of the horizontal plane, walls, piles and rocks, and the first surface that a ray meets.

From the origin o of a pose (x, y, yaw) a ray at azimuth az runs along d = (cos(yaw + az), sin(yaw + az)):

    wall from p_0, e = p_1 - p_0:   t = (p_0 - o) x e / (d x e),   s = (p_0 - o) x d / (d x e),   t >= 0,  0 <= s <= 1
    pile at c of radius r:          t = d . (c - o) - sqrt(q),     q = (d . (c - o))^2 - |c - o|^2 + r^2 >= 0
    cosine of the incidence:        |d x e| / |e|;                 sqrt(q) / r

with a x b = a_x b_y - a_y b_x. The smallest t counts, all behind it is in shadow. Walls and piles reach from surface
to the floor, so a level sonar at any depth sees the same. Rocks are points: they echo, but hide nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Index, Mask
from models.errors import GraphError, OptionError

__all__ = ["Hits", "Scene"]

PAIRS = 1_000_000  # of a ray and a surface at once: 8 MB an array
JOINT = 1e-9  # of a wall: its ends reach over by this, so that no ray slips between two walls with a common end


@dataclass(frozen=True, eq=False)
class Hits:
    """First surface on rays.

    Attributes
    ----------
    range : (p, b) m; inf where no surface is met.
    cosine : (p, b) of the angle of incidence: 1 where the ray meets the surface at right angles; 0 without a hit.
    surface : (p, b) row of the wall, or number of walls plus row of the pile; -1 without a hit.
    """

    range: Array
    cosine: Array
    surface: Index


@dataclass(frozen=True, eq=False)
class Scene:
    """Walls, piles and rocks of the horizontal plane.

    The axes of the world are x north, y east, z down, those of a sonar x ahead, y to starboard, z down. So the yaw of a
    pose is positive clockwise from above, and an azimuth is positive to starboard.

    Parameters
    ----------
    walls : (n, 2, 2) ends of straight vertical walls, (x, y), m.
    piles : (m, 3) vertical cylinders, x, y and radius, m.
    rocks : (k, 2) points, x and y, m.

    Raises
    ------
    GraphError
        An array of another shape, a number that is not finite, a wall of length 0, a radius that is not above 0.

    Examples
    --------
    A quay 5 m north of the origin, and a pile in front of it:

    >>> import numpy as np
    >>> scene = Scene(walls=[[[5, -10], [5, 10]]], piles=[[3, 0, 0.5]])
    >>> scene.first_hits(np.zeros((1, 3)), np.radians([-30, 0, 30]), window=(0.5, 20)).round(3)
    array([[5.774, 2.5  , 5.774]])
    """

    walls: Array = field(default_factory=lambda: np.empty((0, 2, 2)))
    piles: Array = field(default_factory=lambda: np.empty((0, 3)))
    rocks: Array = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        for name, shape in (("walls", (2, 2)), ("piles", (3,)), ("rocks", (2,))):
            object.__setattr__(self, name, _rows(name, getattr(self, name), shape))
        wrong = ~(self._lengths > 0)
        if wrong.any():
            raise GraphError(f"Scene: walls[{int(np.argmax(wrong))}] has length 0; a wall needs two different ends")
        wrong = ~(self.piles[:, 2] > 0)
        if wrong.any():
            k = int(np.argmax(wrong))
            raise GraphError(f"Scene: piles[{k}] has the radius {self.piles[k, 2]:g} m; expected one above 0")

    @property
    def _lengths(self) -> Array:
        return np.asarray(np.hypot(*(self.walls[:, 1] - self.walls[:, 0]).T))

    def first_hits(self, poses: npt.ArrayLike, azimuths: npt.ArrayLike, window: tuple[float, float]) -> Array:
        """Range of the first surface on each ray.

        A surface nearer than the window hides all behind it, too: its ray has no range.

        Parameters
        ----------
        poses : (p, 3) x, y and yaw of the sonar in the world, m and rad.
        azimuths : (b,) of the rays in the frame of the sonar, positive to starboard, rad; or (p, b).
        window : nearest and farthest range, m.

        Returns
        -------
        (p, b) m; inf where no surface is met in the window.

        Raises
        ------
        GraphError, OptionError
            As `hits`; a window without nearest below farthest.
        """
        near, far = window
        if not 0 <= near < far:
            raise OptionError("window", window, "nearest and farthest range, m, 0 <= nearest < farthest")
        r = self.hits(poses, azimuths).range
        return np.where((near <= r) & (r <= far), r, np.inf)

    def hits(self, poses: npt.ArrayLike, azimuths: npt.ArrayLike) -> Hits:
        """First surface on each ray, at any range, with the angle of incidence.

        From inside a pile the first surface is at range 0: such a sonar sees nothing else.

        Parameters
        ----------
        poses : (p, 3) x, y and yaw of the sonar in the world, m and rad.
        azimuths : (b,) of the rays in the frame of the sonar, positive to starboard, rad; or (p, b).

        Returns
        -------
        Hits

        Raises
        ------
        GraphError
            Arrays of other shapes, numbers that are not finite.

        Examples
        --------
        >>> import numpy as np
        >>> scene = Scene(walls=[[[5, -10], [5, 10]]], piles=[[3, 0, 0.5]])
        >>> hits = scene.hits([[0, 0, 0]], np.radians([0, 60, 180]))
        >>> hits.range.round(3), hits.cosine.round(3), hits.surface
        (array([[ 2.5, 10. ,  inf]]), array([[1. , 0.5, 0. ]]), array([[ 1,  0, -1]]))
        """
        poses = _rows("poses", poses, (3,))
        angles = np.asarray(azimuths, dtype=float)
        if angles.ndim not in (1, 2) or (angles.ndim == 2 and len(angles) != len(poses)):
            raise GraphError(f"Scene: azimuths of shape {angles.shape}, expected (b,) or ({len(poses)}, b)")
        if not np.isfinite(angles).all():
            raise GraphError("Scene: azimuths has numbers that are not finite")
        yaw = poses[:, 2:] + angles  # (p, b)
        o = np.repeat(poses[:, :2], yaw.shape[1], axis=0)  # (rays, 2)
        d = np.stack([np.cos(yaw).ravel(), np.sin(yaw).ravel()], axis=1)
        r, cosine = np.full(len(d), np.inf), np.zeros(len(d))
        surface = np.full(len(d), -1, dtype=np.intp)
        surfaces = len(self.walls) + len(self.piles)
        for rays in slices(len(d) if surfaces else 0, max(1, PAIRS // max(surfaces, 1))):
            t, c = (
                np.concatenate(pair, axis=1)
                for pair in zip(self._walls(o[rays], d[rays]), self._piles(o[rays], d[rays]), strict=True)
            )
            first = np.argmin(t, axis=1)[:, None]
            r[rays], cosine[rays] = np.take_along_axis(t, first, 1)[:, 0], np.take_along_axis(c, first, 1)[:, 0]
            surface[rays] = first[:, 0]
        none = np.isinf(r)
        cosine[none], surface[none] = 0.0, -1
        return Hits(r.reshape(yaw.shape), cosine.reshape(yaw.shape), surface.reshape(yaw.shape))

    def visible_rocks(self, pose: npt.ArrayLike) -> Array:
        """Rocks that no surface hides, in the frame of a level sonar.

        Parameters
        ----------
        pose : (3,) x, y and yaw of the sonar in the world, m and rad.

        Returns
        -------
        (k, 3) m; z is 0.

        Raises
        ------
        GraphError
            A pose that is not three finite numbers.

        Examples
        --------
        >>> Scene(piles=[[3, 0, 0.5]], rocks=[[2, 1], [4, 0]]).visible_rocks([0, 0, 0])
        array([[2., 1., 0.]])
        """
        ((x, y, yaw),) = _rows("pose", np.asarray(pose, dtype=float)[None], (3,))
        to = self.rocks - [x, y]
        p = np.stack([to @ [np.cos(yaw), np.sin(yaw)], to @ [-np.sin(yaw), np.cos(yaw)], np.zeros(len(to))], axis=1)
        first = self.hits([[x, y, yaw]], np.arctan2(p[:, 1], p[:, 0])).range[0]
        return np.asarray(p[np.hypot(p[:, 0], p[:, 1]) <= first])

    def _walls(self, o: Array, d: Array) -> tuple[Array, Array]:
        """Range and cosine of rays at walls, (rays, n)."""
        e = self.walls[:, 1] - self.walls[:, 0]
        to = self.walls[:, 0] - o[:, None]  # (rays, n, 2)
        across = _cross(d[:, None], e)
        with np.errstate(divide="ignore", invalid="ignore"):  # along the wall
            t, s = _cross(to, e) / across, _cross(to, d[:, None]) / across
        met = (across != 0) & (t >= 0) & (s >= -JOINT) & (s <= 1 + JOINT)
        return np.where(met, t, np.inf), np.abs(across) / self._lengths

    def _piles(self, o: Array, d: Array) -> tuple[Array, Array]:
        """Range and cosine of rays at piles, (rays, m)."""
        to, radius = self.piles[:, :2] - o[:, None], self.piles[:, 2]
        middle, outside = (to * d[:, None]).sum(axis=2), (to**2).sum(axis=2) - radius**2
        q = middle**2 - outside
        root = np.sqrt(np.maximum(q, 0.0))
        met: Mask = (q >= 0) & (middle >= root)
        t = np.where(met, middle - root, np.inf)
        return np.where(outside < 0, 0.0, t), np.minimum(root / radius, 1.0)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _rows(name: str, rows: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    """A copy (n, *shape), finite."""
    array = np.array(rows, dtype=float)
    array = array.reshape(0, *shape) if array.size == 0 else array
    if array.shape[1:] != shape or array.ndim != len(shape) + 1:
        raise GraphError(f"Scene: {name} of shape {array.shape}, expected (n, {', '.join(map(str, shape))})")
    if not np.isfinite(array).all():
        row = np.argwhere(~np.isfinite(array))[0][0]
        raise GraphError(f"Scene: {name}[{row}] is {array[row].tolist()}; expected finite numbers")
    return array


def slices(count: int, size: int) -> Iterator[slice]:
    """Portions of so many rows, of this size at most."""
    return (slice(begin, begin + size) for begin in range(0, count, size))
