r"""Scan matching by correlation: every pose in a window is scored, so that a second answer cannot hide.

    S(T) = sum_k L(T p_k)        over the points p_k of a scan, L the field of the map, T = (x, y, yaw)

For one yaw, S over all x and y is a correlation, and so a product of Fourier transforms. The best cell of the window is
the start of Gauss-Newton on S, with the residuals and the Jacobian

    r_k = sqrt(2 (L_max - L(T p_k))),      J_k = -(1 / r_k) (dL/dq) (dq/dT)

The covariance has the second moments of the scores as a probability, P(T) = exp(S(T) / t) / sum, about the pose: along
a wall the scores hardly fall, and the covariance is wide. Points of one surface are no independent witnesses: however
many there are, they count as `INDEPENDENT`, t = n / INDEPENDENT.

Source: E. Olson, "Real-time correlative scan matching", ICRA 2009 (window, covariance from the scores); K. Konolige,
K. Chou, "Markov localization using correlation", IJCAI 1999 (temper).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from models import SE2
from models.algebra import Array, wrap
from models.errors import GraphError, ResourceLimitError
from models.options import check_positive
from nls.missions.scans.field import STRAY, Field

__all__ = ["Match", "match", "match_submap"]

INDEPENDENT = 40.0  # independent points in a match: with as many or fewer, every point counts
YAW_STEP = float(np.radians(1.0))
AWAY = 2.0  # m from the best pose, where another is a second answer
FLOOR = np.array([0.1, 0.1, 0.005])  # sigmas, m m rad, below which no match is: cells
STEPS = 10  # Gauss-Newton steps at most
CELLS = 50_000_000  # most scores of a window, with their transforms 1 GB
REACH = np.array([0.8, 0.8, 2 * YAW_STEP])  # m, m, rad: farthest from the best cell, that of the score, to the pose
HALVINGS = 4  # of a step that does not raise the score
LEAST_STEP = 0.002  # squared sigmas by the tempered score, below which a step is not taken
BENT = np.array([0.4, 0.4, 0.025])  # sigmas, m m rad, of a submap that is not rigid: dead reckoning drifts within it
NARROW = 1e-4  # share of the largest eigenvalue below which a direction is not seen


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
    away = np.hypot((offsets - offsets[best[1]])[:, None], offsets - offsets[best[2]]) > AWAY
    second = float(S.max(axis=0)[away].max()) if away.any() else 0.0
    P = np.exp((S - peak) * min(1.0, INDEPENDENT / len(p)), dtype=np.float64)
    P /= P.sum()
    start = np.array([T[0] + offsets[best[1]], T[1] + offsets[best[2]], T[2] + yaws[best[0]]])
    pose = _refined(field, p, start)
    R = SE2.rotation(pose[None])[0]
    C = _moments(P, yaws - wrap(pose[2] - T[2]), offsets - (pose[0] - T[0]), offsets - (pose[1] - T[1]))
    C[:2] = R.T @ C[:2]
    C[:, :2] = C[:, :2] @ R
    edge = float(1.0 - P[1:-1, 1:-1, 1:-1].sum())
    return Match(pose, C + np.diag(FLOOR**2), peak / len(p), second / len(p), edge)


def match_submap(field: Field, points: Array, guess: Array, window: tuple[float, float]) -> Match:
    """As `match`, of submaps: they are bent by the drift within them, and the covariance says so."""
    fit = match(field, points, guess, window)
    return replace(fit, covariance=fit.covariance + np.diag(BENT**2))


def scores(
    field: Field, p: Array, guess: Array, window: tuple[float, float]
) -> tuple[npt.NDArray[np.float32], Array, Array]:
    """S (yaws, n, n) of all poses in a window, with their yaws and their x and y (n,), from the guess."""
    from scipy.fft import ifft, irfft, next_fast_len, rfft2

    reach, turns = int(np.ceil(window[0] / field.resolution)), int(np.ceil(window[1] / YAW_STEP))
    yaws = np.asarray(YAW_STEP * np.arange(-turns, turns + 1), dtype=np.float64)
    offsets = np.asarray(field.resolution * np.arange(-reach, reach + 1), dtype=np.float64)
    nx, ny = (next_fast_len(side + 2 * reach + 1, True) for side in field.L.shape)
    if (cells := len(yaws) * nx * ny) > CELLS:
        raise ResourceLimitError(
            f"match: {len(yaws)} x {nx} x {ny} scores, expected at most {CELLS:,}: take a smaller window, or "
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
    temper = min(1.0, INDEPENDENT / len(p))
    for _ in range(STEPS):
        J = np.column_stack([slope, slope[:, 1] * turned[:, 0] - slope[:, 0] * turned[:, 1]])  # dL/dT
        r2 = np.maximum(2 * (-np.log(STRAY) - L), 1e-2)
        gradient = J.sum(axis=0)
        step = np.linalg.lstsq((J / r2[:, None]).T @ J, gradient, rcond=NARROW)[0]
        if temper * (gradient @ step) < LEAST_STEP:
            break
        for halving in range(HALVINGS + 1):
            candidate = best + np.clip(T + step / 2**halving - best, -REACH, REACH)
            turned_there, L_there, slope_there = moved(candidate)
            if L_there.sum() > L.sum():
                break
        else:
            break
        T, turned, L, slope = candidate, turned_there, L_there, slope_there
    return np.append(T[:2], wrap(T[2]))
