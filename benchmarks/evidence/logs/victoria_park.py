r"""A truck among the trees of a park for 26 minutes and 4 km: wheel speed, steering, trees seen by a laser, GPS.

Files ``DRS.txt``, ``LASER_TREE.txt`` and ``GPS.txt`` (each may end in ``.gz``). A scan is a time and then a range and a
bearing for every tree detected in it. The trees have no names. Bearings are positive to the left.

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

from models.algebra import Array, Index
from nls.io.text import plain_lines, plain_table, refuse_late

from .table import or_compressed

__all__ = ["VictoriaPark", "read_victoria_park"]


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
