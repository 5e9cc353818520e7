r"""Scan matching by correlation: every pose in a window is scored, so that a second answer cannot hide.

    S(T) = sum_k L(T p_k)        over the points p_k of a scan, L the field of the map, T = (x, y, yaw)

The field L says how likely a point is where others were measured: a bounded log-likelihood on a grid.

    L(q) = log(e + (1 - e) exp(-d(q)^2 / (2 s^2))) - log(e),      d(q) the distance from q to the nearest point

where s is the noise of a point and e the share of points that belong to nothing in the map. L is 0 far from all points
and -log(e) on one, so that a wrong point costs no more than 3. Squared distances on a grid are whole numbers of squared
cells, and the least of them along x of the least along y.

For one yaw, S over all x and y is a correlation, and so a product of Fourier transforms. The best cell of the window is
the start of Gauss-Newton on S, with the residuals and the Jacobian

    r_k = sqrt(2 (L_max - L(T p_k))),      J_k = -(1 / r_k) (dL/dq) (dq/dT)

The covariance has the second moments of the scores as a probability, P(T) = exp(S(T) / t) / sum, about the pose: along
a wall the scores hardly fall, and the covariance is wide. Points of one surface are no independent witnesses: however
many there are, they count as 40, t = n / 40.

Source: E. Olson, "Real-time correlative scan matching", ICRA 2009 (window, covariance from the scores); K. Konolige,
K. Chou, "Markov localization using correlation", IJCAI 1999 (temper); S. Thrun, W. Burgard, D. Fox, Probabilistic
Robotics, 2005, section 6.4 (likelihood fields); P. Felzenszwalb, D. Huttenlocher, "Distance transforms of sampled
functions", Theory of Computing 8, 2012 (one axis after the other).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from models import SE2
from models.algebra import Array, Index, wrap
from models.errors import GraphError, ResourceLimitError
from models.options import check_positive

STRAY_SHARE = 0.05  # e
MOST_CELLS = 40_000_000  # of a grid: 160 MB, and 200 MB while it is made
MOST_SCORES = 50_000_000  # of a window, with their transforms 1 GB
INDEPENDENT_POINTS = 40.0  # in a match: with as many or fewer, every point counts
YAW_STEP = float(np.radians(1.0))
BENT_SUBMAP = np.array([0.4, 0.4, 0.025])  # sigmas, m m rad: dead reckoning drifts within a submap
Squares = npt.NDArray[np.unsignedinteger]


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
        margin = 4.0 * sigma  # from a point; L is below 0.007 there, and 0 beyond
        self.origin = p.min(axis=0) - margin
        sides = np.ceil((p.max(axis=0) + margin - self.origin) / resolution) + 1
        if sides.prod() > MOST_CELLS:
            raise GraphError(
                f"Field: {sides[0]:.0f} x {sides[1]:.0f} cells of {resolution:g} m; expected at most {MOST_CELLS:,}: "
                "take a larger resolution, or leave out points that are far away"
            )
        reach = int(np.ceil(margin / resolution))
        far = (reach + 1) ** 2  # squared cells, and the same number for all that is farther
        squares: Squares = np.full(sides.astype(int), far, dtype=np.min_scalar_type(2 * far))
        squares[tuple(self.cells(p).T)] = 0
        squares = _least_along(_least_along(squares, reach).T, reach).T
        likelihood = STRAY_SHARE + (1 - STRAY_SHARE) * np.exp(-0.5 * np.arange(far) * (resolution / sigma) ** 2)
        self.L: npt.NDArray[np.float32] = np.append(np.log(likelihood / STRAY_SHARE), 0.0).astype(np.float32)[squares]
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


@dataclass(frozen=True)
class Match:
    """Where a scan fits into a map.

    Attributes
    ----------
    pose : (3,) of the scan in the frame of the map: x, y, m, and yaw, rad.
    covariance : (3, 3) of x, y and yaw in the frame of the scan, m and rad, as `factors.Between` takes it.
    score : log-likelihood for every point, from 0, nothing fits, to 3, all do.
    second : the best score farther than 2 m from the pose; 0 where the window has no such place.
    edge : probability at the rim of the window, where the search ended and not the map.
    """

    pose: Array
    covariance: Array
    score: float
    second: float
    edge: float

    @property
    def ratio(self) -> float:
        """Second score over the first: near 1 the match is ambiguous."""
        return self.second / self.score if self.score > 0 else 1.0

    @property
    def spread(self) -> float:
        """Largest standard deviation of the position, m."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))


def match(field: Field, points: npt.ArrayLike, guess: npt.ArrayLike, window: tuple[float, float]) -> Match:
    """The pose at which points fit best into a field, among all in a window around a guess.

    Parameters
    ----------
    field : of the map.
    points : (n, 2) of the scan, m, in its own frame.
    guess : (3,) pose of the scan in the frame of the map.
    window : half widths of the search: in x and y, m, and in yaw, rad.

    Raises
    ------
    GraphError
        No points, wrong shapes, numbers that are not finite.
    OptionError
        A window that is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> corner = np.array([[k, 0.0] for k in range(10)] + [[0.0, k] for k in range(1, 10)])
    >>> shifted = corner - [0.7, -0.4]
    >>> pose = match(Field(corner), shifted, guess=[0.0, 0.0, 0.0], window=(2.0, 0.1)).pose
    >>> bool(np.abs(pose - [0.7, -0.4, 0.0]).max() < 0.1)
    True
    """
    p, T = np.asarray(points, dtype=float), np.asarray(guess, dtype=float)
    if p.ndim != 2 or p.shape[1:] != (2,) or not len(p) or T.shape != (3,):
        raise GraphError(f"match: points {p.shape} and guess {T.shape}; expected (n, 2), at least one, and (3,)")
    if not (np.isfinite(p).all() and np.isfinite(T).all()):
        raise GraphError("match: points or guess are not finite")
    check_positive(position_window=window[0], yaw_window=window[1])
    S, yaws, offsets = scores(field.coarse, p, T, window)
    best = np.unravel_index(S.argmax(), S.shape)
    peak = float(S[best])
    away = np.hypot((offsets - offsets[best[1]])[:, None], offsets - offsets[best[2]]) > 2.0
    second = float(S.max(axis=0)[away].max()) if away.any() else 0.0
    P = np.exp((S - peak) * min(1.0, INDEPENDENT_POINTS / len(p)), dtype=np.float64)
    P /= P.sum()
    start = np.array([T[0] + offsets[best[1]], T[1] + offsets[best[2]], T[2] + yaws[best[0]]])
    pose = _refined(field, p, start)
    R = SE2.rotation(pose[None])[0]
    C = _moments(P, yaws - wrap(pose[2] - T[2]), offsets - (pose[0] - T[0]), offsets - (pose[1] - T[1]))
    C[:2] = R.T @ C[:2]
    C[:, :2] = C[:, :2] @ R
    edge = float(1.0 - P[1:-1, 1:-1, 1:-1].sum())
    floor = np.array([0.1, 0.1, 0.005])  # sigmas, m m rad, below which no match is: cells
    return Match(pose, C + np.diag(floor**2), peak / len(p), second / len(p), edge)


def match_submap(field: Field, points: Array, guess: Array, window: tuple[float, float]) -> Match:
    """As `match`, of submaps: they are bent by the drift within them, and the covariance says so."""
    fit = match(field, points, guess, window)
    return replace(fit, covariance=fit.covariance + np.diag(BENT_SUBMAP**2))


def scores(
    field: Field, p: Array, guess: Array, window: tuple[float, float]
) -> tuple[npt.NDArray[np.float32], Array, Array]:
    """S (yaws, n, n) of all poses in a window, with their yaws and their x and y (n,), from the guess."""
    from scipy.fft import ifft, irfft, next_fast_len, rfft2

    reach, turns = int(np.ceil(window[0] / field.resolution)), int(np.ceil(window[1] / YAW_STEP))
    yaws = np.asarray(YAW_STEP * np.arange(-turns, turns + 1), dtype=np.float64)
    offsets = np.asarray(field.resolution * np.arange(-reach, reach + 1), dtype=np.float64)
    nx, ny = (next_fast_len(side + 2 * reach + 1, True) for side in field.L.shape)
    if (cells := len(yaws) * nx * ny) > MOST_SCORES:
        raise ResourceLimitError(
            f"match: {len(yaws)} x {nx} x {ny} scores, expected at most {MOST_SCORES:,}: take a smaller window, or "
            "leave out points that are far away",
            float(cells),
        )
    poses = np.column_stack([np.broadcast_to(guess[:2], (len(yaws), 2)), guess[2] + yaws])
    q = p @ np.swapaxes(SE2.rotation(poses), 1, 2) + poses[:, None, :2]
    image, k, l = np.repeat(np.arange(len(yaws)), len(p)), *field.cells(q.reshape(-1, 2)).T
    sides = field.L.shape
    inside = (k >= -reach) & (k < sides[0] + reach) & (l >= -reach) & (l < sides[1] + reach)
    row, column = (k[inside] - reach) % nx, (l[inside] - reach) % ny  # so that the offset -reach is the first of S
    counts = np.zeros((len(yaws), nx, ny), dtype=np.float32)
    np.add.at(counts.reshape(-1), (image[inside] * nx + row) * ny + column, np.float32(1.0))
    spectra = np.conj(rfft2(counts, axes=(1, 2))) * field.spectrum((nx, ny))
    lines = ifft(spectra, axis=1, overwrite_x=True)[:, : 2 * reach + 1]
    S: npt.NDArray[np.float32] = irfft(lines, ny, axis=2)[:, :, : 2 * reach + 1]
    return S, yaws, offsets


def _moments(P: Array, yaw: Array, x: Array, y: Array) -> Array:
    """Second moments (3, 3) of x, y and yaw, from the stated pose, under probabilities P (yaws, n, n)."""
    of_xy, of_yaw_x, of_yaw_y = P.sum(axis=0), P.sum(axis=2), P.sum(axis=1)
    C = np.diag([of_xy.sum(axis=1) @ x**2, of_xy.sum(axis=0) @ y**2, of_yaw_x.sum(axis=1) @ yaw**2])
    C[0, 1] = C[1, 0] = x @ of_xy @ y
    C[0, 2] = C[2, 0] = yaw @ of_yaw_x @ x
    C[1, 2] = C[2, 1] = yaw @ of_yaw_y @ y
    return C


def _refined(field: Field, p: Array, T: Array) -> Array:
    """Gauss-Newton on the field, around the best cell. A direction that the field does not show is not moved along."""

    def moved(T: Array) -> tuple[Array, Array, Array]:
        turned = p @ SE2.rotation(T[None])[0].T
        return turned, *field.at(turned + T[:2])

    best, (turned, L, slope) = T, moved(T)
    temper = min(1.0, INDEPENDENT_POINTS / len(p))
    reach = np.array([0.8, 0.8, 2 * YAW_STEP])  # m, m, rad: farthest from the best cell, that of the score, to the pose
    for _ in range(10):
        J = np.column_stack([slope, slope[:, 1] * turned[:, 0] - slope[:, 0] * turned[:, 1]])  # dL/dT
        r2 = np.maximum(2 * (-np.log(STRAY_SHARE) - L), 1e-2)
        gradient = J.sum(axis=0)
        step = np.linalg.lstsq((J / r2[:, None]).T @ J, gradient, rcond=1e-4)[0]
        if temper * (gradient @ step) < 0.002:  # squared sigmas by the tempered score
            break
        for halving in range(5):
            candidate = best + np.clip(T + step / 2**halving - best, -reach, reach)
            turned_there, L_there, slope_there = moved(candidate)
            if L_there.sum() > L.sum():
                break
        else:
            break
        T, turned, L, slope = candidate, turned_there, L_there, slope_there
    return np.append(T[:2], wrap(T[2]))
