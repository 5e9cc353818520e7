"""The solution of a mission as CSV files: the trajectory and the map, with what is known of how good they are."""

from __future__ import annotations

import numpy as np

from factors.keys import Kind, kinds
from models import euler
from models.algebra import Array
from nls.covariance import Marginals
from nls.io.mission.calibration import NAMES
from nls.io.mission.columns import COLUMNS, PLACE, suffixed
from nls.io.mission.solution import Elevations
from nls.io.mission.table import csv_text
from nls.values import Values

__all__ = ["MAP", "TRAJECTORY", "beacons_text", "calibration_text", "map_text", "trajectory_text"]

x, l, b = kinds("x", "l", "b")
BEACONS = ("beacon", *PLACE, *suffixed(PLACE))
TRAJECTORY = (*COLUMNS["truth"], *suffixed(COLUMNS["truth"][1:]))
UPPER = np.triu_indices(3)
MAP = (
    *("landmark", *PLACE),
    *(f"cov_{'xyz'[row]}_{'xyz'[column]}_m2" for row, column in zip(*UPPER, strict=True)),
    *("views", "first_i", "elevation_rad", "sigma_elevation_rad", "at_limit"),
)


def trajectory_text(values: Values, marginals: Marginals | None) -> bytes:
    """trajectory.csv: the Euler 6-vector of every pose and its standard deviations, empty where there are none.

    Raises
    ------
    SingularGeometryError
        A pose at gimbal lock.
    """
    stack = values.stack("x")
    sigmas = None
    if marginals is not None:
        sigmas = np.sqrt(np.diagonal(marginals.all(x, view="euler"), axis1=1, axis2=2))
    return csv_text(TRAJECTORY, stack.numbers, euler.from_se3(stack.X), _or_empty(sigmas, (len(stack), 6)))


def map_text(values: Values, marginals: Marginals | None, elevations: Elevations) -> bytes:
    """map.csv: landmarks with their covariance along the axes of the world, their views, and their elevation.

    The elevation is the one in the frame of the sonar at the first view; at_limit is 1 where a hinge pushes it back
    into the aperture. Cells are empty where there are no sigmas: of all landmarks without marginals, else of those that
    are free.
    """
    n, keys, known = len(elevations.landmarks), l[elevations.landmarks], np.isfinite(elevations.sigma)[:, None]
    Sigma = (
        None
        if marginals is None
        else np.where(known, elevations.bounded(marginals.covariance(keys))[:, *UPPER], np.nan)
    )
    sigma = None if marginals is None else elevations.sigma[:, None]
    return csv_text(
        MAP,
        *(elevations.landmarks, values[keys], _or_empty(Sigma, (n, 6)), elevations.views, elevations.poses),
        *(elevations.elevation[:, None], _or_empty(sigma, (n, 1)), elevations.pushed.astype(int)),
    )


def beacons_text(values: Values, marginals: Marginals | None) -> bytes:
    """beacons.csv: the estimated places of the beacons with their standard deviations, which another mission reads."""
    stack = values.stack(b)
    sigmas = None if marginals is None else np.sqrt(np.diagonal(marginals.all(b), axis1=1, axis2=2))
    return csv_text(BEACONS, stack.numbers, np.asarray(stack.X), _or_empty(sigmas, (len(stack), 3)))


def calibration_text(values: Values, marginals: Marginals | None) -> bytes:
    """calibration.csv: the estimated numbers of the sensors with their standard deviations."""
    names = [name for name in NAMES if name in values.stacks]
    estimates = [[float(values.stack(name).X[0, 0])] for name in names]
    sigmas = None
    if marginals is not None:
        sigmas = np.array([[np.sqrt(float(marginals.all(Kind(name))[0, 0, 0]))] for name in names])
    return csv_text(COLUMNS["calibration"], names, estimates, _or_empty(sigmas, (len(names), 1)))


def _or_empty(numbers: Array | None, shape: tuple[int, int]) -> list[list[str]]:
    """Cells, empty where a number is not known."""
    rows = np.full(shape, np.nan) if numbers is None else numbers
    return [["" if np.isnan(number) else repr(number) for number in row] for row in rows.tolist()]
