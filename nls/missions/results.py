"""The solution of a mission as CSV files: trajectory, map, beacons and calibrations, and how well each is known."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from factors.keys import Keys, Kind, kinds
from models import euler
from models.algebra import Array, Mask, Numbers
from nls.covariance import Marginals
from nls.io.table import EMPTY
from nls.missions.folder.calibration import NAMES
from nls.missions.folder.columns import COLUMNS, PLACE, POSE, suffixed
from nls.missions.folder.table import csv_text
from nls.missions.solution import Elevations
from nls.values import Values

__all__ = ["MAP", "TRAJECTORY", "beacons_text", "calibration_text", "map_text", "trajectory_text"]

x, l, b = kinds("x", "l", "b")
TRAJECTORY = (*POSE, *suffixed(POSE[1:]))
UPPER = np.triu_indices(3)
MAP = (
    *("landmark", *PLACE),
    *(f"cov_{'xyz'[row]}_{'xyz'[column]}_m2" for row, column in zip(*UPPER, strict=True)),
    *("views", "first_i", "elevation_rad", "sigma_elevation_rad", "at_limit", "mirrored"),
)


def trajectory_text(
    values: Values, marginals: Marginals | None, extra: Mapping[str, Array] = {}, unmeasured: Collection[str] = ()
) -> bytes:
    """trajectory.csv: the Euler 6-vector of every pose and its standard deviations, empty where a pose has none.

    Both are empty in the columns that nothing measures. Extra columns are times and coordinates on the Earth.

    Raises
    ------
    SingularGeometryError
        A pose at gimbal lock.
    """
    stack = values.stack("x")
    state = np.hstack([euler.from_se3(stack.X), _sigmas(covariances(values, marginals, x, "euler"))])
    state[:, [name.split("_")[0] in unmeasured for name in POSE[1:]] * 2] = np.nan
    return csv_text((*TRAJECTORY, *extra), stack.numbers, or_empty(state), *extra.values())


def beacons_text(values: Values, marginals: Marginals | None, extra: Mapping[str, Array] = {}) -> bytes:
    """beacons.csv: the estimated beacons ``b``, with the columns of the file of a mission."""
    stack, sigmas = values.stack("b"), _sigmas(covariances(values, marginals, b))
    names = ("beacon", *PLACE, *suffixed(PLACE), *extra)
    return csv_text(names, stack.numbers, np.asarray(stack.X), or_empty(sigmas), *extra.values())


def calibration_text(values: Values, marginals: Marginals | None) -> bytes:
    """calibration.csv: the estimated calibrations and their standard deviations, as in the file of a mission."""
    names = [name for name in values.stacks if name in NAMES]
    numbers = np.array([[float(values.stack(name).X[0, 0])] for name in names])
    sigmas = np.array([_sigmas(covariances(values, marginals, Kind(name)))[0] for name in names])
    return csv_text(COLUMNS["calibration"], names, numbers, or_empty(sigmas))


def covariances(values: Values, marginals: Marginals | None, kind: Kind, view: str | None = None) -> Array:
    """Covariances (n, k, k) of the variables of a kind, nan where there are none; view as for `nls.Marginals`."""
    stack = values.stack(kind)
    size = 3 if view == "position" else stack.manifold.dim
    Sigma = np.full((len(stack), size, size), np.nan)
    if marginals is not None and (known := determined(marginals, kind, stack.numbers)).any():
        Sigma[known] = marginals.covariance(kind[stack.numbers[known]], view=view)
    return Sigma


def _sigmas(Sigma: Array) -> Array:
    """Standard deviations (n, k), nan where there are none."""
    return np.asarray(np.sqrt(np.diagonal(Sigma, axis1=1, axis2=2)))


def determined(marginals: Marginals, kind: Kind, numbers: Numbers) -> Mask:
    """Which variables (n,) of a kind have a covariance."""
    known = ~np.isin(marginals.status(kind), EMPTY)
    return np.asarray(known[marginals.values.stack(kind).index(kind[numbers])])


def undetermined(marginals: Marginals, kind: Kind) -> Keys:
    """The variables of a kind without a covariance."""
    numbers = marginals.values.stack(kind).numbers
    return kind[numbers[~determined(marginals, kind, numbers)]]


def map_text(
    values: Values, marginals: Marginals | None, elevations: Elevations, extra: Mapping[str, Array] = {}
) -> bytes:
    """map.csv: landmarks with their covariance along the axes of the world, their views, and their elevation.

    The elevation is the one in the frame of the sonar at the first view; at_limit is 1 where a hinge pushes it back
    into the aperture, mirrored is 1 where the other sign of the elevation fits as well. Cells are empty where there are
    no sigmas: of all landmarks without marginals, else of those that are free.
    """
    Sigma = np.full((len(elevations.landmarks), 6), np.nan)
    if marginals is not None:
        Sigma = landmark_covariances(marginals, elevations)[:, *UPPER]
    return csv_text(
        (*MAP, *extra),
        *(elevations.landmarks, values[l[elevations.landmarks]], or_empty(Sigma), elevations.views, elevations.poses),
        *(elevations.elevation[:, None], or_empty(elevations.sigma[:, None]), elevations.pushed.astype(int)),
        np.where(np.isnan(elevations.sigma), "", elevations.mirrored.astype(int).astype(str)),
        *extra.values(),
    )


def landmark_covariances(marginals: Marginals, elevations: Elevations) -> Array:
    """Covariances (n, 3, 3) of landmarks with what the aperture of the sonar says of them; nan where one is free."""
    known = np.isfinite(elevations.sigma)
    Sigma = np.full((len(known), 3, 3), np.nan)
    if known.any():
        Sigma[known] = marginals.covariance(l[elevations.landmarks[known]])
        Sigma[known] = elevations.bounded(Sigma)[known]
    return Sigma


def or_empty(rows: Array) -> list[list[str]]:
    """Cells, empty where a number is not known."""
    return [["" if np.isnan(number) else repr(number) for number in row] for row in rows.tolist()]
