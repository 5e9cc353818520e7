"""Robots of the plane among 15 landmarks: velocity commands, ranges and bearings with identities, motion capture.

Files ``RobotN_Odometry.dat``, ``RobotN_Measurement.dat``, ``RobotN_Groundtruth.dat`` (each may end in ``.gz``),
``Landmark_Groundtruth.dat`` and ``Barcodes.dat``. Targets are known by their barcodes: subjects 1 to 5 are the robots,
6 to 20 landmarks. A few barcodes are misread and nobody's. Bearings are positive to the left; the camera is taken for
the middle of the robot, as in the publication.

Source: K. Leung, Y. Halpern, T. Barfoot, H. Liu, "The UTIAS multi-robot cooperative localization and mapping dataset",
IJRR 30(8), 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models import wrap
from models.algebra import Array, Index, Numbers
from nls.io.text import Text, plain_table

from .table import or_compressed

__all__ = ["Mrclam", "read_mrclam"]


@dataclass(frozen=True)
class Mrclam:
    """One robot; world x, y as in the motion capture; all times in seconds from the first row of its truth.

    Attributes
    ----------
    t : (n,) times of the commands, rising; of several at one time the last is kept.
    u : (n, 2) commanded velocity ahead, m/s, and rate of turn, rad/s.
    t_seen : (m,) times of the sightings, not falling.
    subject : (m,) what was seen; 0 where the barcode is nobody's.
    z : (m, 2) bearing, rad, and range, m.
    t_truth, truth : (k,) times, and (k, 3) true poses SE2.
    landmarks, places : (15,) subjects, and (15, 2) their surveyed places, m.
    """

    t: Array
    u: Array
    t_seen: Array
    subject: Numbers
    z: Array
    t_truth: Array
    truth: Array
    landmarks: Numbers
    places: Array

    def true_poses(self, t: Array) -> Array:
        """True poses (n, 3) at times (n,), on the straight line between the two captured before and after.

        Before the first and after the last they are these.
        """
        x, y, yaw = (
            np.interp(t, self.t_truth, column) for column in (*self.truth[:, :2].T, np.unwrap(self.truth[:, 2]))
        )
        return np.column_stack([x, y, wrap(yaw)])


def read_mrclam(folder: str | Path, robot: int) -> Mrclam:
    """The log of one robot.

    Raises
    ------
    GraphFileError
        With the line: a file that cannot be read, another count of numbers, a time that falls, a range that is not
        above 0; a barcode or subject that is no whole number or given twice.
    """
    folder = Path(folder)
    commands, *_ = _timed(folder, f"Robot{robot}_Odometry.dat", 3, "time, velocity, rate of turn")
    measurements, text, lines = _timed(folder, f"Robot{robot}_Measurement.dat", 4, "time, barcode, range, bearing")
    truth, *_ = _timed(folder, f"Robot{robot}_Groundtruth.dat", 4, "time, x, y, heading")
    if (bad := ~(measurements[:, 2] > 0)).any():
        raise text.error("no range is 0 or below", int(lines[np.argmax(bad)]))
    t_0 = truth[0, 0]
    last = np.append(np.diff(commands[:, 0]) > 0, True)
    barcode = text.whole(lines, 1)

    text, lines, _, _ = plain_table(folder / "Barcodes.dat", 2, "subject, barcode")
    subjects, barcodes = text.whole(lines, 0), text.whole(lines, 1)
    _once("subject", text, lines, subjects)
    order = _once("barcode", text, lines, barcodes)
    at = order[np.minimum(np.searchsorted(barcodes, barcode, sorter=order), len(order) - 1)]

    text, lines, survey, _ = plain_table(folder / "Landmark_Groundtruth.dat", 5, "subject, x, y, their sigmas")
    landmarks = text.whole(lines, 0)
    _once("subject", text, lines, landmarks)
    return Mrclam(
        commands[last, 0] - t_0,
        commands[last, 1:],
        measurements[:, 0] - t_0,
        np.where(barcodes[at] == barcode, subjects[at], 0),
        measurements[:, [3, 2]],
        truth[:, 0] - t_0,
        truth[:, 1:],
        landmarks,
        survey[:, 1:3],
    )


def _timed(folder: Path, name: str, columns: int, expected: str) -> tuple[Array, Text, Index]:
    """The numbers of a file or of its compressed twin, in the order of time; its text and lines."""
    text, lines, numbers, _ = plain_table(or_compressed(folder, name), columns, expected)
    times = numbers[:, 0]
    if len(late := np.flatnonzero(np.diff(times) < 0)):
        k = late[0] + 1
        raise text.error(f"time {float(times[k])!r} is before the {float(times[k - 1])!r} before it", int(lines[k]))
    return numbers, text, lines


def _once(noun: str, text: Text, lines: Index, numbers: Numbers) -> Index:
    """The order of numbers (n,), each of which is given once."""
    order = np.argsort(numbers, kind="stable")
    if len(again := np.flatnonzero(np.diff(numbers[order]) == 0)):
        k = order[again[0] + 1]
        raise text.error(f"{noun} {numbers[k]} was given before", int(lines[k]))
    return order
