r"""Public logs of vehicles among landmarks as arrays; files may end in ``.gz``.

**MRCLAM**: robots of the plane among 15 landmarks; velocity commands, ranges and bearings with identities, and motion
capture. Files ``RobotN_Odometry.dat``, ``RobotN_Measurement.dat``, ``RobotN_Groundtruth.dat``,
``Landmark_Groundtruth.dat`` and ``Barcodes.dat``. Targets are known by their barcodes: subjects 1 to 5 are the robots,
6 to 20 landmarks. A few barcodes are misread and nobody's. Bearings are positive to the left; the camera is taken for
the middle of the robot, as in the publication.

Source: K. Leung, Y. Halpern, T. Barfoot, H. Liu, "The UTIAS multi-robot cooperative localization and mapping dataset",
IJRR 30(8), 2011.

**Victoria Park**: a truck among the trees of a park for 26 minutes and 4 km; wheel speed, steering, trees seen by a
laser, GPS. Files ``DRS.txt``, ``LASER_TREE.txt`` and ``GPS.txt``. A scan is a time and then a range and a bearing
for every tree detected in it. The trees have no names. Bearings are positive to the left.

GPS has two columns of meters. Taken for x and y they are the mirror image of the track by wheels and laser. Over the
first five minutes SLAM fits them to 1.0 m mirrored, 9.0 m otherwise. So they are taken for north and east.

The encoder is on the left rear wheel, the laser at the left end of the front bumper; their places are those used with
the data in the source: J. Guivant, E. Nebot, "Optimization of the simultaneous localization and map-building algorithm
for real-time implementation", IEEE Transactions on Robotics and Automation 17(3), 2001.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models import wrap
from models.algebra import Array, Index, Numbers
from nls.io.text import Text, plain_lines, plain_table, refuse_late


def or_compressed(folder: str | Path, name: str) -> Path:
    """The file of a folder, or its compressed twin ``name.gz`` where only that is there."""
    path = Path(folder) / name
    twin = path.with_name(f"{name}.gz")
    return twin if twin.exists() and not path.exists() else path


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
    seen = measurements[:, 0] - t_0, np.where(barcodes[at] == barcode, subjects[at], 0), measurements[:, [3, 2]]
    true = truth[:, 0] - t_0, truth[:, 1:]
    return Mrclam(commands[last, 0] - t_0, commands[last, 1:], *seen, *true, landmarks, survey[:, 1:3])


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


@dataclass(frozen=True)
class VictoriaPark:
    """The log; x ahead, y to the left.

    Attributes
    ----------
    t : (n,) times of wheel speed and steering, s.
    u : (n, 2) speed of the left rear wheel, m/s, and steering angle, rad, positive to the left.
    t_scan : (m,) times of the scans, s.
    scan : (k,) the scan of each sighting, 0 to m - 1, rising.
    z : (k, 2) bearing, rad, and range, m, of a tree from the laser.
    t_gps, gps : (g,) times, and (g, 2) places as in the file, east and north, m.
    wheelbase, encoder, laser : of the truck, m, as `models.vehicles.ackermann` takes them.
    """

    t: Array
    u: Array
    t_scan: Array
    scan: Index
    z: Array
    t_gps: Array
    gps: Array
    wheelbase: float = 2.83
    encoder: float = 0.76
    laser: tuple[float, float] = (3.78, 0.50)


def read_victoria_park(folder: str | Path) -> VictoriaPark:
    """Read the log.

    Raises
    ------
    GraphFileError
        With the line: a file that cannot be read, another count of numbers, half a pair in a scan; a time that does not
        rise, a range that is not above 0.
    """
    drs, gps, trees = (or_compressed(folder, name) for name in ("DRS.txt", "GPS.txt", "LASER_TREE.txt"))
    tables = []
    for path, columns in ((drs, "time, wheel speed, steering"), (gps, "time, north, east")):
        text, lines, numbers, _ = plain_table(path, 3, columns)
        refuse_late(text, lines, numbers[:, 0])
        tables.append(numbers)
    text, lines, count, _ = plain_lines(trees, "no scan; expected lines of a time and pairs of range and bearing")
    if (odd := count % 2 == 0).any():
        k = int(np.argmax(odd))
        raise text.error(f"{count[k]} numbers, expected a time and pairs of range and bearing", int(lines[k]))
    first = np.concatenate([[0], np.cumsum(count)])
    tokens = np.repeat(text.first[lines] - first[:-1], count) + np.arange(first[-1])
    numbers = text.numbers(tokens, np.repeat(lines, count), 1)
    time = np.zeros(len(numbers), dtype=bool)
    time[first[:-1]] = True
    scan, z = np.repeat(np.arange(len(lines)), count // 2), numbers[~time].reshape(-1, 2)[:, ::-1]
    refuse_late(text, lines, numbers[time])
    if (bad := ~(z[:, 1] > 0)).any():
        raise text.error("no range is 0 or below", int(lines[scan[np.argmax(bad)]]))
    (drs_rows, gps_rows), t_scan = tables, numbers[time]
    return VictoriaPark(
        drs_rows[:, 0], drs_rows[:, 1:], t_scan, scan, np.ascontiguousarray(z), gps_rows[:, 0], gps_rows[:, [2, 1]]
    )
