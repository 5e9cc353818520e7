"""The solution of a mission as CSV files: the trajectory and the map, with what is known of how good they are."""

from __future__ import annotations

import numpy as np

from factors.keys import Keys, Kind, kinds
from models import euler
from models.algebra import Array, Mask
from nls.covariance import Marginals
from nls.io.covariance_csv import EMPTY
from nls.io.mission.columns import COLUMNS, PLACE, suffixed
from nls.io.mission.solution import Elevations
from nls.io.mission.table import csv_text
from nls.values import Values

__all__ = ["MAP", "TRAJECTORY", "map_text", "trajectory_text"]

x, l = kinds("x", "l")
TRAJECTORY = (*COLUMNS["truth"], *suffixed(COLUMNS["truth"][1:]))
UPPER = np.triu_indices(3)
MAP = (
    *("landmark", *PLACE),
    *(f"cov_{'xyz'[row]}_{'xyz'[column]}_m2" for row, column in zip(*UPPER, strict=True)),
    *("views", "first_i", "elevation_rad", "sigma_elevation_rad", "at_limit"),
)


def trajectory_text(values: Values, marginals: Marginals | None) -> bytes:
    """trajectory.csv: the Euler 6-vector of every pose and its standard deviations, empty where a pose has none.

    Raises
    ------
    SingularGeometryError
        A pose at gimbal lock.
    """
    stack = values.stack("x")
    sigmas = np.full((len(stack), 6), np.nan)
    if marginals is not None and (known := determined(marginals, x)).any():
        Sigma = marginals.covariance(x[stack.numbers[known]], view="euler")
        sigmas[known] = np.sqrt(np.diagonal(Sigma, axis1=1, axis2=2))
    return csv_text(TRAJECTORY, stack.numbers, euler.from_se3(stack.X), _or_empty(sigmas))


def determined(marginals: Marginals, kind: Kind) -> Mask:
    """Which variables (n,) of a kind have a covariance, in the order of the values."""
    return ~np.isin(marginals.status(kind), EMPTY)


def undetermined(marginals: Marginals, kind: Kind) -> Keys:
    """The variables of a kind without a covariance."""
    return kind[marginals.values.stack(kind.name).numbers[~determined(marginals, kind)]]


def map_text(values: Values, marginals: Marginals | None, elevations: Elevations) -> bytes:
    """map.csv: landmarks with their covariance along the axes of the world, their views, and their elevation.

    The elevation is the one in the frame of the sonar at the first view; at_limit is 1 where a hinge pushes it back
    into the aperture. Cells are empty where there are no sigmas: of all landmarks without marginals, else of those that
    are free.
    """
    n, keys, known = len(elevations.landmarks), l[elevations.landmarks], np.isfinite(elevations.sigma)
    Sigma = np.full((n, 6), np.nan)
    if marginals is not None and known.any():
        blocks = np.full((n, 3, 3), np.nan)
        blocks[known] = marginals.covariance(keys[known])
        Sigma[known] = elevations.bounded(blocks)[known][:, *UPPER]
    return csv_text(
        MAP,
        *(elevations.landmarks, values[keys], _or_empty(Sigma), elevations.views, elevations.poses),
        *(elevations.elevation[:, None], _or_empty(elevations.sigma[:, None]), elevations.pushed.astype(int)),
    )


def _or_empty(rows: Array) -> list[list[str]]:
    """Cells, empty where a number is not known."""
    return [["" if np.isnan(number) else repr(number) for number in row] for row in rows.tolist()]
