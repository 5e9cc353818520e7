r"""How likely a point is where others were measured: a bounded log-likelihood on a grid.

    L(q) = log(e + (1 - e) exp(-d(q)^2 / (2 s^2))) - log(e),      d(q) the distance from q to the nearest point

where s is the noise of a point and e the share of points that belong to nothing in the map. L is 0 far from all points
and -log(e) on one, so that a wrong point costs no more than 3.

Squared distances on a grid are whole numbers of squared cells, and the least of them along x of the least along y.

Source: S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005, section 6.4 (likelihood fields); P. Felzenszwalb,
D. Huttenlocher, "Distance transforms of sampled functions", Theory of Computing 8, 2012 (one axis after the other).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Index
from models.errors import GraphError
from models.options import check_positive

__all__ = ["Field"]

Squares = npt.NDArray[np.unsignedinteger]
STRAY = 0.05  # e
FAR = 4.0  # sigmas from a point, where L is below 0.007: 0 beyond
CELLS = 40_000_000  # most cells of a grid: 160 MB, and 200 MB while it is made


class Field:
    """Log-likelihood of points on a grid, from points that were measured.

    Parameters
    ----------
    points : (n, 2) measured points, m.
    sigma : s, the noise of a point and of the poses from which it was seen, m.
    resolution : side of a cell, m.

    Attributes
    ----------
    L : (nx, ny) float32, at the centers of the cells; outside the grid L is 0.
    origin : (2,) center of cell (0, 0), m.
    sigma, resolution : as given.

    Raises
    ------
    GraphError
        No points, wrong shapes, numbers that are not finite; points too far apart for the grid.
    OptionError
        A sigma or a resolution that is not above 0.

    Examples
    --------
    >>> field = Field([[0.0, 0.0], [3.0, 0.0]], sigma=0.5, resolution=0.1)
    >>> field.at([[3.0, 0.0], [3.0, 0.5], [50.0, 0.0]])[0].round(2)
    array([3.  , 2.52, 0.  ])
    """

    def __init__(self, points: npt.ArrayLike, sigma: float = 0.5, resolution: float = 0.2) -> None:
        check_positive(sigma=sigma, resolution=resolution)
        p = np.asarray(points, dtype=float)
        if p.ndim != 2 or p.shape[1] != 2 or not len(p):
            raise GraphError(f"Field: points of shape {p.shape}; expected (n, 2), at least one")
        if not np.isfinite(p).all():
            raise GraphError(f"Field: point {int(np.argmin(np.isfinite(p).all(axis=1)))} is not finite")
        self.points, self.sigma, self.resolution = p, float(sigma), float(resolution)
        margin = FAR * sigma
        self.origin = p.min(axis=0) - margin
        sides = np.ceil((p.max(axis=0) + margin - self.origin) / resolution) + 1
        if sides.prod() > CELLS:
            raise GraphError(
                f"Field: {sides[0]:.0f} x {sides[1]:.0f} cells of {resolution:g} m; expected at most {CELLS:,}: "
                "take a larger resolution, or leave out points that are far away"
            )
        reach = int(np.ceil(margin / resolution))
        far = (reach + 1) ** 2  # squared cells, and the same number for all that is farther
        squares: Squares = np.full(sides.astype(int), far, dtype=np.min_scalar_type(2 * far))
        squares[tuple(self.cells(p).T)] = 0
        squares = _least_along(_least_along(squares, reach).T, reach).T
        likelihood = STRAY + (1 - STRAY) * np.exp(-0.5 * np.arange(far) * (resolution / sigma) ** 2)
        self.L: npt.NDArray[np.float32] = np.append(np.log(likelihood / STRAY), 0.0).astype(np.float32)[squares]
        self._spectra: dict[tuple[int, ...], npt.NDArray[np.complex64]] = {}

    def __repr__(self) -> str:
        return f"Field({len(self.points)} points, {self.L.shape[0]} x {self.L.shape[1]} cells of {self.resolution:g} m)"

    @cached_property
    def coarse(self) -> Field:
        """The field of the same points in cells twice as large."""
        return Field(self.points, self.sigma, 2 * self.resolution)

    def cells(self, q: Array) -> Index:
        """The cells (n, 2) in which points are; beyond the grid below 0 or above its last."""
        return np.asarray(np.rint((q - self.origin) / self.resolution), dtype=np.intp)

    def at(self, q: npt.ArrayLike) -> tuple[Array, Array]:
        """L (n,) and its gradient (n, 2), 1/m, at points (n, 2), linear between the centers of cells."""
        u = ((np.asarray(q, dtype=float) - self.origin) / self.resolution).T
        k, l = i = np.floor(u).astype(np.intp)
        (nx, ny), L = self.L.shape, self.L.reshape(-1)
        inside = (k >= 0) & (k < nx - 1) & (l >= 0) & (l < ny - 1)
        (f, g), corner = u - i, np.where(inside, k * ny + l, 0)
        a, b, c, d = L[corner], L[corner + ny], L[corner + 1], L[corner + ny + 1]
        low, high = a + (b - a) * f, c + (d - c) * f
        slope = np.column_stack([(b - a) * (1 - g) + (d - c) * g, high - low]) / self.resolution
        return (low + (high - low) * g) * inside, slope * inside[:, None]

    def spectrum(self, shape: tuple[int, ...]) -> npt.NDArray[np.complex64]:
        """Fourier transform of L, with zeros around it up to a shape; computed once for every shape."""
        from scipy.fft import rfft2

        if shape not in self._spectra:
            self._spectra[shape] = rfft2(self.L, shape)
        return self._spectra[shape]


def _least_along(squares: Squares, reach: int) -> Squares:
    """Squared distances (nx, ny), in cells, to what is at most `reach` cells away along x, from those along y."""
    least = np.copy(squares)
    for k in range(1, reach + 1):
        np.minimum(least[k:], squares[:-k] + k**2, out=least[k:])
        np.minimum(least[:-k], squares[k:] + k**2, out=least[:-k])
    return least
