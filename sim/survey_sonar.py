"""Marks on the bottom by the imaging sonar of a survey: contacts.csv, sonar.csv, and their poses."""

from __future__ import annotations

from math import radians

import numpy as np

from models import SE3, euler
from models.algebra import Array, wrap
from models.errors import GraphError
from models.sensors import ImagingSonar, range_azimuth
from sim.mission import visible
from sim.survey_log import Tables
from sim.survey_track import TrueTrack, sounded

__all__ = ["sonar_tables"]

SONAR = ImagingSonar("forward-looking sonar", 256, 512, radians(90.0), radians(20.0), (3.0, 40.0))
MOUNT = (0.0, radians(-30.0), 0.0, 0.8, 0.0, 0.1)  # roll, pitch, yaw, x, y, z on the vehicle: looks down ahead
SIGMAS = np.array([0.1, radians(0.5)])  # of range, m, and azimuth, rad
SEEN_EVERY, FEWEST = 2, 3  # s from image to image; contacts of a landmark, those seen less often are left out
SAME = 1e-3  # s: the reader takes times that are closer for one
AROUND = 10.0  # m


def sonar_tables(
    rng: np.random.Generator, track: TrueTrack, landmarks: int, noise_scale: float, tables: Tables
) -> tuple[Tables, Array]:
    """The files of the sonar, and the places (m, 3) of the landmarks that it saw three times, numbered from 0.

    Parameters
    ----------
    rng : source of the landmarks and of the noise.
    track : the true one.
    landmarks : how many there are on the bottom.
    noise_scale : factor on the drawn noise.
    tables : the other files; poses.csv gets a pose at every time of theirs and one a second.

    Raises
    ------
    GraphError
        No landmark is seen three times.
    """
    xy = rng.uniform(-AROUND, track.size + AROUND, size=(landmarks, 2))
    points = np.column_stack([xy, sounded(xy)])
    grid = np.arange(0.0, track.duration + 0.5)
    stamped = [tables[name] for name in ("fixes", "ranges", "usbl")]
    others = np.unique(np.concatenate([table["time_s"] - table.get("delay_s", 0.0) for table in stamped]))
    others = others[np.abs(others - np.round(others)) > SAME]
    times = np.sort(np.concatenate([grid, others[np.diff(others, prepend=-1.0) > SAME]]))
    t = grid[::SEEN_EVERY]
    X, offset = track.pose(t), euler.to_se3([MOUNT])[0]
    i, k = visible(X, points, SONAR, offset)
    often = np.bincount(k, minlength=landmarks) >= FEWEST
    i, k = i[often[k]], (np.cumsum(often) - 1)[k[often[k]]]
    points = points[often]
    if not len(points):
        raise GraphError(
            f"survey: none of {landmarks} landmarks is seen {FEWEST} times; make the landmarks or the legs more"
        )
    p = SE3.act(SE3.inverse(SE3.compose(X, offset[None]))[i], points[k])
    z = range_azimuth(p)[0] + noise_scale * SIGMAS * rng.standard_normal((len(i), 2))
    columns: tuple[str, ...] = ("name", "beams", "bins", "fan_rad", "aperture_rad", "range_min_m", "range_max_m")
    columns += ("roll_rad", "pitch_rad", "yaw_rad", "x_m", "y_m", "z_m")
    row = (f'"{SONAR.name}"', SONAR.beams, SONAR.bins, SONAR.fan, SONAR.aperture, *SONAR.window, *MOUNT)
    sonar = {name: np.array([value]) for name, value in zip(columns, row, strict=True)}
    contacts = {
        "i": np.searchsorted(times, t)[i],
        "landmark": k,
        "range_m": np.round(z[:, 0], 6),
        "azimuth_rad": np.round(wrap(z[:, 1]), 9),
        "sigma_range_m": np.full(len(i), SIGMAS[0]),
        "sigma_azimuth_rad": np.full(len(i), SIGMAS[1]),
    }
    return {"poses": {"i": np.arange(len(times)), "time_s": times}, "sonar": sonar, "contacts": contacts}, points
