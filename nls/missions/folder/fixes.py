"""Positions: origin.csv, anchor.csv, fixes.csv and closures.csv, poses as seen from others, of other dives, too."""

import numpy as np

from factors import XYH, Between, Diagonal, Heading, Position
from factors.base import Factor
from factors.keys import Keys, kinds
from models import euler
from models.algebra import Array, Numbers
from models.errors import OptionError
from models.geodesy import REACH, LocalPlane
from nls.io.report import Source
from nls.missions.folder.calibration import Compass
from nls.missions.folder.columns import ANGLES, GEODETIC, LEVEL, PLACE, UPRIGHT, suffixed
from nls.missions.folder.rows import Assembly, arms, columns_together
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline, one_of

Pose = tuple[Keys, Array]  # and x, y and yaw (3,) that it is to have
(x,) = kinds("x")


def plane_of(origin: Table | None) -> LocalPlane | None:
    """The local plane at the one row of origin.csv."""
    if origin is None:
        return None
    if len(origin) > 1:
        raise origin.at(1, "a second origin; a mission has one")
    lat, lon = origin.measured("lat_deg", "lon_deg")[0].tolist()
    try:
        return LocalPlane(lat, lon)
    except OptionError as error:
        raise origin.at(0, str(error)) from error


def horizontal(table: Table, plane: LocalPlane | None) -> Array:
    """North and east (n, 2) of the places of a file, m, from x and y or from latitude and longitude.

    Raises
    ------
    GraphFileError
        Both, neither, or a latitude without origin.csv or far from it.
    """
    if one_of(table, ("x_m", "y_m"), GEODETIC):
        return table.measured("x_m", "y_m")
    lat_lon = table.measured(*GEODETIC)
    table.refuse_numbers(np.abs(lat_lon[:, 0]) > 90, lat_lon[:, 0], "degrees, -90 to 90", "lat_deg")
    if plane is None:
        first = ",".join(repr(number) for number in lat_lon[0].tolist())
        cure = f"write origin.csv with one row of lat_deg,lon_deg, such as {first}"
        raise table.at_names(f"has latitudes, and no file says where x = y = 0 is; {cure}")
    p = plane.local(*lat_lon.T)
    far = np.linalg.norm(p, axis=1)
    if (beyond := ~(far <= REACH)).any():
        k = int(np.argmax(beyond))
        a, b = lat_lon[k]
        meant = {
            "lat_deg, lon_deg exchanged": (b, a),
            "lon_deg times -1": (a, -b),
            "lat_deg times -1": (-a, b),
            "lat_deg, lon_deg read in rad": (np.degrees(a), np.degrees(b)),
        }
        places = {how: plane.local(*np.array(at)[:, None]) for how, at in meant.items() if abs(at[0]) <= 90}
        near = {how: d for how, place in places.items() if (d := np.linalg.norm(place)) <= REACH}
        hints = "".join(f"; with {how} it is {d / 1000:.3g} km" for how, d in near.items())
        why = ", so one of the two files is wrong" if hints else ""
        raise table.at(k, f"is {far[k] / 1000:.6g} km from origin.csv; expected at most 1,000 km{hints}{why}")
    return p


def add_anchor(mission: Assembly, numbers: Numbers, compass: Compass | None, anchored: bool) -> Pose | None:
    """Add the anchor of the mission in the world: x, y and heading of a pose; the first such pose with these numbers.

    Nothing and None where other measurements are absolute. Else where nobody says so it is the first pose: at the
    truth, else at the first row of path.csv, else at 0. Its heading is held only where no compass measures it; with a
    compass it is the first pose that this one sees. Where the mission need not be anchored, nothing holds it.
    """
    tables, report = mission.tables, mission.report
    if (table := tables.get("anchor")) is not None:
        table.unique("i", "pose")
        i = table.known("i", numbers, "nothing else measures this pose; anchor one of the track")
        z, sigmas = table.measured(*LEVEL), table.positive(*suffixed(LEVEL))
        for factor in _held(x[i], z, sigmas):
            mission.add(factor, table.source())
        return x[i[:1]], z[0]
    if report.world:
        return None
    anchor, z, where = x[numbers[:1]], np.zeros(3), "0"
    if "path" in tables:
        z, where = tables["path"].attitude(*LEVEL)[0], "the first row of path.csv"
    if compass is not None:
        poses, yaw = compass
        first = int(np.argmin(poses.numbers))
        anchor, z[2] = poses[[first]], yaw[first]
    if "x" in report.truth.stacks and anchor in report.truth:
        true, where = euler.from_se3(report.truth[anchor])[0, [3, 4, 2]], "the truth"
        z = true if compass is None else np.append(true[:2], z[2])
    if not anchored:
        return anchor, z
    below_any_vehicle = np.array([[1e-3, 1e-3, 1e-4]])  # m, m, rad: what none knows of itself
    factors, held = _held(anchor, z[None], below_any_vehicle), "x, y and yaw"
    if compass is not None:
        factors, held = factors[:1], "x and y"
    for factor in factors:
        mission.add(factor, Source(report.path, np.zeros(1, dtype=np.intp)))
    report.notes.append(f"there is no anchor.csv: {held} of {anchor} are fixed at {where}")
    if report.plane is not None and compass is None and where == "0":
        report.warn(f"the position of {anchor} on the Earth and its heading are unknown; write both to anchor.csv")
    return anchor, z


def _held(poses: Keys, z: Array, sigmas: Array) -> list[Factor]:
    """x, y and yaw (n, 3) of poses with their standard deviations."""
    return [
        Position(poses, z[:, :2], Diagonal(sigmas[:, :2]), components=("x", "y")),
        Heading(poses, z[:, 2:], Diagonal(sigmas[:, 2:])),
    ]


def add_fixes(mission: Assembly, timeline: Timeline) -> None:
    """Add the `Position` factors of fixes.csv.

    Raises
    ------
    GraphFileError
        Columns that do not fit together, no such pose or time, a place that cannot be.
    """
    if (table := mission.tables.get("fixes")) is None:
        return
    poses, rows = timeline.poses("fixes", table)
    names: tuple[str, ...] = ("x", "y")
    z = horizontal(table, mission.report.plane)
    if columns_together(table, "z_m", "sigma_z_m"):
        names, z = ("x", "y", "z"), np.column_stack([z, table.measured("z_m")])
    sigmas, arm = table.positive(*suffixed(PLACE[: len(names)])), arms(table)
    fixes = Position(x[poses[:, 0]], z, Diagonal(sigmas), components=names, offset=arm)
    mission.add_rows(table, rows, fixes)


def add_closures(mission: Assembly, timeline: Timeline) -> None:
    """Add the factors of closures.csv: `Between` where it has all six coordinates, `XYH` where it has three.

    Raises
    ------
    GraphFileError
        Other columns, no such pose or time, a pose with itself.
    """
    if (table := mission.tables.get("closures")) is None:
        return
    poses, rows = timeline.poses("closures", table)
    same = rows & (poses[:, 0] == poses[:, 1])
    table.refuse_rows(same, lambda k: f"the closure connects pose {poses[k, 0]} to itself")
    mission.add_rows(table, rows, closures(table, x[poses[:, 0]], x[poses[:, 1]]))


def closures(table: Table, i: Keys, j: Keys) -> Between | XYH:
    """The factor of n rows that say where the poses j (n,) are in the axes of the poses i (n,).

    Raises
    ------
    GraphFileError
        Numbers that cannot be.
    """
    whole = columns_together(table, *UPRIGHT, *suffixed(UPRIGHT))
    names = (*PLACE, *ANGLES) if whole else LEVEL
    z, sigmas = table.attitude(*names), table.positive(*suffixed(names))
    if whole:
        z = euler.to_se3(np.column_stack([z[:, 3:], z[:, :3]]))
    return (Between if whole else XYH)(i, j, z, Diagonal(sigmas))
