r"""A raw log as arrays, and its redundancy: the depth by the DVL, and the way from fix to fix.

    (d, D)(t) = sum of R(t) R_mount v_d(t) dt - (R(t) - R(0)) a

d north and east, D down, a and R_mount the mounting of the DVL on the vehicle, the trapezoidal rule from row to row.

Other readings of a mission are mistakes that are made with units, signs, frames and clocks, undone. A reading takes the
numbers y of some columns of a file as A y + c. It is one thing for the quick checks, which try it on a `Log`, and for
the trials by the solver, which try it on the tables.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from models import SO3, euler
from models.algebra import Array, Index, Mask, apply, wrap
from models.geodesy import LocalPlane
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.missions.checks.findings import Cause, Reading
from nls.missions.folder.calibration import Calibrations
from nls.missions.folder.columns import ANGLES, GEODETIC, PLACE, TILT, VELOCITY
from nls.missions.folder.dvl import bottom_lock
from nls.missions.folder.table import Table

SPEED_UNITS = (1000.0, 100.0, 1.9438, 3.2808, 3.6)  # mm/s, cm/s, knots, ft/s and km/h in a m/s
LENGTH_UNITS = (100.0, 3.2808, 0.5468, 10.0, 0.001, 0.1, 0.01)  # cm, feet, fathoms, kPa, km, bar, kPa to dm
PLACE_UNITS = (1000.0, 100.0, 3.2808, 0.001)
RANGE_UNITS = (*PLACE_UNITS, 2.0, 0.5)  # both ways, and one of two
DEGREES = 180 / np.pi
TURN_UNITS = (DEGREES, 1 / DEGREES)  # degrees in a column of radians, radians that were taken for degrees
LAGS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0)  # s
LEVEL = ("x_m", "y_m")
PLANE = ((LEVEL, PLACE_UNITS), (("yaw_rad",), TURN_UNITS))
FROM_NORTH = Reading(Cause.NORTH, "usbl.csv", "bearing_rad")
LOGGED = {  # of a file: where a `Log` has its numbers and its times, and the columns of the numbers
    "dvl.csv": ("v", "t_v", VELOCITY),
    "ahrs.csv": ("rpy", "t_a", ANGLES),
    "depth.csv": ("z", "t_z", ("z_m",)),
}
OF_TABLES: dict[str, tuple[tuple[tuple[str, ...], Iterable[float]], ...]] = {  # vectors of one unit; what that may be
    "fixes": ((LEVEL, PLACE_UNITS),),
    "odometry": PLANE,
    "path": (*PLANE, (("z_m",), LENGTH_UNITS)),
    "zpr": tuple(((name,), (DEGREES,) if name.endswith("_rad") else LENGTH_UNITS) for name in TILT),
    "closures": PLANE,
    "contacts": ((("azimuth_rad",), TURN_UNITS), (("range_m",), PLACE_UNITS)),
    "usbl": ((("bearing_rad", "elevation_rad"), TURN_UNITS), (("range_m",), RANGE_UNITS)),
    "ranges": ((("range_m",), RANGE_UNITS), (("travel_time_s",), (1e3, 1e6, 2.0, 0.5))),  # ms, us
    "ship": (*PLANE, (("roll_rad", "pitch_rad"), ()), (("z_m",), ())),
    "beacons": ((LEVEL, PLACE_UNITS), (("z_m",), ())),
}


@dataclass(frozen=True)
class Fixes:
    """Positions: times t (n,), p (n, 2) north and east, m, standard deviation (n,), m; and the columns of p.

    `rows` are those of the table; `others` places (n, 2), m, with latitude and longitude exchanged, or of another side.
    """

    t: Array
    p: Array
    sigma: Array
    columns: tuple[str, str]
    rows: Index
    others: tuple[tuple[Reading, Array], ...] = ()


@dataclass(frozen=True)
class Log:
    """The tables of a raw log as numbers, SI.

    Attributes
    ----------
    t_v, v, valid : times (n,), velocities (n, 3) along the axes of the DVL, and which rows have bottom lock.
    t_a, rpy : times (m,) and angles (m, 3) as in the file.
    t_z, z : times and depths (k,).
    mount : (7,) pose of the DVL on the vehicle, SE3.
    sigmas : of one velocity, angle and depth, by name of noise.csv.
    fixes : None where there are none.
    """

    t_v: Array
    v: Array
    valid: Mask
    t_a: Array
    rpy: Array
    t_z: Array
    z: Array
    mount: Array
    sigmas: dict[str, float]
    fixes: Fixes | None = None

    def thinned(self) -> Log:
        """Without lost samples and single outliers of DVL and depth, about a sample a second, at most 10,000."""
        t, v = self.t_v[self.valid], middle(self.v[self.valid])
        step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        chosen = np.arange(0, len(t), max(1, int(1 / step)))[:10_000]
        return replace(self, t_v=t[chosen], v=v[chosen], valid=np.ones(len(chosen), dtype=bool), z=middle(self.z))

    def _attitude(self) -> Array:
        """Attitude (n, 4) at the times of the DVL."""
        rpy = np.column_stack([np.interp(self.t_v, self.t_a, angle) for angle in np.unwrap(self.rpy, axis=0).T])
        return quaternion_from_angles(rpy)

    def axes(self) -> Array:
        """Rotations (n, 3, 3) of the axes of the DVL into north, east and down."""
        q = self._attitude()
        return np.asarray(rotation3(SO3.compose(q, np.broadcast_to(self.mount[3:], q.shape))))

    def way(self) -> Array:
        """North, east and down (n, 3) by the DVL at each of its times, m, from the first."""
        q, w = self._attitude(), apply(self.axes(), self.v)
        steps = 0.5 * (w[1:] + w[:-1]) * np.diff(self.t_v)[:, None]
        arm = apply(rotation3(q), np.broadcast_to(self.mount[:3], (len(q), 3)))
        return np.asarray(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) - (arm - arm[0]))


def middle(y: Array) -> Array:
    """The median of each number and its two neighbors, along the first axis.

    Examples
    --------
    >>> middle(np.array([1.0, 2.0, 90.0, 4.0, 5.0])).tolist()
    [1.0, 2.0, 4.0, 5.0, 5.0]
    """
    out = np.array(y)
    if len(y) > 2:
        a, b, c = y[:-2], y[1:-1], y[2:]
        out[1:-1] = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return out


def read_log(tables: dict[str, Table], plane: LocalPlane | None) -> Log | None:
    """The raw log of a mission, calibrated; None without one, of a short one, or with a number that the reader refuses.

    None also with gyro.csv and pressure.csv, whose mistakes are others, and without a sigma that the reader asks for.

    Raises
    ------
    GraphFileError
        A cell that is no number, a time that does not rise.
    """
    if "dvl" not in tables or {"gyro", "pressure"} & tables.keys():
        return None
    if not tables["ahrs"].has("yaw_rad") or not tables["noise"].has("sigma_yaw_rad"):
        return None
    dvl, ahrs, depth = (tables[name] for name in ("dvl", "ahrs", "depth"))
    t_v, t_a, t_z = (table.rising("time_s") for table in (dvl, ahrs, depth))
    valid, largest = bottom_lock(dvl, []), 1e9  # of a number, as the reader has it
    mount = tables["dvl_mount"].floats(*ANGLES, *PLACE)[0] if "dvl_mount" in tables else np.zeros(6)
    noise = tables["noise"]
    v, rpy, z = dvl.floats(*VELOCITY), ahrs.floats(*ANGLES), depth.floats("z_m")
    if min(len(t_v[valid]), len(t_a), len(t_z)) < 5:
        return None
    if not max(float(np.abs(y).max()) for y in (v[valid], rpy, z, mount)) < largest:
        return None
    v = np.where(valid[:, None] | (np.abs(v) < largest), v, 0.0)
    sigmas = dict(zip(noise.names, noise.floats(*noise.names)[0].tolist(), strict=True))
    fixes = read_fixes(tables.get("fixes"), plane)
    log = Log(t_v, v, valid, t_a, rpy, t_z, z[:, 0], euler.to_se3(mount), sigmas, fixes)
    if dvl.has("earth_axes"):
        earth = dvl.flags("earth_axes", "1 where the velocity is north, east and down")
        log = replace(log, v=np.where(earth[:, None], apply(log.axes().mT, log.v), log.v))
    c = Calibrations(tables.get("calibration")).value
    turn = c("dvl_yaw_rad")
    R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return replace(
        log,
        v=log.v @ R.T / (1 + c("dvl_scale")),
        t_a=log.t_a - c("ahrs_clock_s"),
        rpy=log.rpy + np.array([0.0, 0.0, c("declination_rad")]),
        fixes=fixes and replace(fixes, t=fixes.t - c("fixes_clock_s")),
    )


def read_fixes(table: Table | None, plane: LocalPlane | None) -> Fixes | None:
    """Positions with times; None without any, or where only the numbers of poses are given."""
    if table is None or not table.has("time_s"):
        return None
    sigma = np.hypot(*table.floats("sigma_x_m", "sigma_y_m").T)
    t = table.floats("time_s")[:, 0]
    order: Index = np.argsort(t, kind="stable")
    if table.has("x_m", "y_m"):
        return Fixes(t[order], table.floats("x_m", "y_m")[order], sigma[order], ("x_m", "y_m"), order)
    if not table.has("lat_deg", "lon_deg") or plane is None:
        return None
    lat, lon = table.floats("lat_deg", "lon_deg")[order].T
    others = (
        (Reading(Cause.SWAPPED, "fixes.csv", "lat_deg, lon_deg"), plane.local(lon, lat)),
        (Reading(Cause.SIGN, "fixes.csv", "lon_deg", -1.0), plane.local(lat, -lon)),
        (Reading(Cause.SIGN, "fixes.csv", "lat_deg", -1.0), plane.local(-lat, lon)),
    )
    return Fixes(t[order], plane.local(lat, lon), sigma[order], ("lat_deg", "lon_deg"), order, others)


@dataclass(frozen=True)
class Alternative:
    """A reading; A (k, k) and c (k,) make of the numbers of its columns those that were meant."""

    reading: Reading
    A: Array
    c: Array

    def on_log(self, log: Log) -> Log:
        """The log that was meant."""
        if self.reading.cause is Cause.EARTH:
            return replace(log, v=apply(log.axes().mT, log.v))
        numbers, times, names = LOGGED[self.reading.file]
        if self.reading.columns == ["time_s"]:
            return replace(log, **{times: getattr(log, times) + self.c[0]})
        read, k = getattr(log, numbers), [names.index(name) for name in self.reading.columns]
        y: Any = np.array(read).reshape(len(read), -1)
        y[:, k] = self._meant(y[:, k])
        return replace(log, **{numbers: y.reshape(read.shape)})

    def on_tables(self, tables: dict[str, Table]) -> dict[str, Table]:
        """The tables that were meant; those of latitudes and longitudes in all of them. Empty without the file."""
        if self.reading.cause is Cause.EARTH:
            log = read_log(tables, None)
            return tables | {"dvl": tables["dvl"].with_numbers(VELOCITY, self.on_log(log).v)} if log else {}
        if self.reading == FROM_NORTH:
            return _from_the_bow(tables)
        columns = self.reading.columns
        names = tables if columns[0] in GEODETIC else [self.reading.file.removesuffix(".csv")]
        own = {name: tables[name] for name in names if name in tables and tables[name].has(*columns)}
        meant = {name: t.with_numbers(columns, self._meant(t.floats(*columns))) for name, t in own.items()}
        return tables | meant if meant else {}

    def _meant(self, y: Array) -> Array:
        return np.asarray(y @ self.A.T + self.c)


def times_of_poses(poses: Table, rows: Table, column: str = "i") -> Array:
    """The times (n,) by poses.csv of the poses that a column of rows names; nan beyond the last one."""
    numbers = poses.integers("i")
    order = np.argsort(numbers)
    return np.append(poses.floats("time_s")[order, 0], np.nan)[np.searchsorted(numbers[order], rows.integers(column))]


def _from_the_bow(tables: dict[str, Table]) -> dict[str, Table]:
    """Bearings of a USBL less the heading of the ship; empty where nothing says the times of its rows."""
    if not {"usbl", "ship"} <= tables.keys():
        return {}
    ship, usbl = tables["ship"], tables["usbl"]
    if usbl.has("time_s"):
        t = usbl.floats("time_s")[:, 0]
    elif "poses" in tables:
        t = times_of_poses(tables["poses"], usbl)
    else:
        return {}
    t_s, yaw = ship.floats("time_s", "yaw_rad").T
    bearing = usbl.floats("bearing_rad")[:, 0] - np.interp(t, t_s, np.unwrap(yaw))
    return tables | {"usbl": usbl.with_numbers(("bearing_rad",), wrap(bearing)[:, None])}


def alternatives() -> list[Alternative]:
    """All readings that are tried for a log."""
    return [*_of_a_log(), *(_late(file, lag) for lag in _both(LAGS) for file in LOGGED)]


def readings(tables: dict[str, Table]) -> list[Alternative]:
    """All readings that are tried for tables: not the clocks and turns that are calibrations."""
    file, of_tables = "fixes.csv", [a for name in OF_TABLES for a in _of_table(name)]
    return [
        *(a for name in ("ahrs", "dvl") if name in tables for a in _drifts(f"{name}.csv", tables[name])),
        *_of_a_log(),
        _north("ahrs.csv"),
        _read(Cause.NORTH, "ahrs.csv", ANGLES[1:], -np.eye(2), 90.0, (0.0, np.pi / 2)),
        Alternative(FROM_NORTH, np.eye(1), np.zeros(1)),
        *of_tables,
        *_exchanged(file, GEODETIC),
        *_signs(file, GEODETIC),
        *_units(file, GEODETIC, [1 / DEGREES]),
        *(_late("ship.csv", lag) for lag in _both((4.0, 8.0, 12.0, 18.0, 30.0))),  # beside them chi2 is linear enough
    ]


def _both(sizes: Iterable[float]) -> list[float]:
    """Sizes of either sign."""
    return [sign * size for size in sizes for sign in (1, -1)]


def corrected(reading: Reading) -> Alternative:
    """Without the error of a whole table: a clock that is late or fast, an arm, a scale."""
    known = {Cause.DRIFT: (1 / (1 + reading.factor), reading.offset), Cause.SCALE: (1 / reading.factor, 0.0)}
    A, c = known.get(reading.cause, (1.0, -reading.factor))
    return Alternative(reading, np.array([[A]]), np.array([c]))


def _read(
    cause: Cause, file: str, columns: Iterable[str], A: npt.ArrayLike, factor: float = 1.0, c: npt.ArrayLike = 0.0
) -> Alternative:
    A = np.atleast_2d(np.asarray(A, dtype=float))
    return Alternative(Reading(cause, file, ", ".join(columns), factor), A, np.broadcast_to(c, len(A)))


def _units(file: str, columns: tuple[str, ...], factors: Iterable[float]) -> list[Alternative]:
    return [_read(Cause.UNIT, file, columns, np.eye(len(columns)) / f, f) for f in factors]


def _signs(file: str, columns: Iterable[str]) -> list[Alternative]:
    return [_read(Cause.SIGN, file, [name], -1, -1.0) for name in columns]


def _exchanged(file: str, *pairs: tuple[str, str]) -> list[Alternative]:
    return [_read(Cause.SWAPPED, file, pair, [[0, 1], [1, 0]]) for pair in pairs]


def _of_a_log() -> list[Alternative]:
    """Columns of dvl.csv, ahrs.csv and depth.csv."""
    file, (x, y, z), ahrs, (roll, pitch, yaw) = "dvl.csv", VELOCITY, "ahrs.csv", ANGLES
    return [
        *(a for names in (VELOCITY, (x,), (y,), (z,)) for a in _units(file, names, SPEED_UNITS)),
        *_signs(file, VELOCITY),
        _read(Cause.SIGN, file, VELOCITY, -np.eye(3), -1.0),
        *_exchanged(file, (x, y), (x, z), (y, z)),
        _read(Cause.EARTH, file, VELOCITY, np.eye(3)),
        _read(Cause.AXES, file, VELOCITY, np.diag([1.0, -1.0, -1.0])),
        *_signs(ahrs, ANGLES),
        *_exchanged(ahrs, (roll, pitch)),
        *(a for names in ((yaw,), (pitch,), (roll,), (roll, pitch)) for a in _units(ahrs, names, TURN_UNITS)),
        *_signs("depth.csv", ["z_m"]),
        *_units("depth.csv", ("z_m",), LENGTH_UNITS),
    ]


def _north(file: str) -> Alternative:
    return _read(Cause.NORTH, file, ["yaw_rad"], -1, 90.0, np.pi / 2)


def _drifts(file: str, table: Table) -> Iterator[Alternative]:
    """A clock that runs fast or slow since the first row; it is compared with motion, which is not linear in it."""
    for r in _both((0.003, 0.01)):
        begin = float(table.floats("time_s")[0, 0])
        yield corrected(Reading(Cause.DRIFT, file, "time_s", r, r / (1 + r) * begin))


def _late(file: str, lag: float) -> Alternative:
    return _read(Cause.CLOCK, file, ["time_s"], 1, lag, -lag)


def _of_table(name: str) -> Iterator[Alternative]:
    """Columns of a table without a raw log, or beside it: units, signs, exchange, a heading from east."""
    file = f"{name}.csv"
    for columns, factors in OF_TABLES[name]:
        if len(columns) == 2:
            yield from _exchanged(file, (columns[0], columns[1]))
        if not columns[0].startswith(("range", "travel")):
            yield from _signs(file, columns)
        if columns == ("yaw_rad",):
            yield _north(file)
        angles = len(columns) > 1 and columns[0].endswith("_rad")
        for names in (columns, *((name,) for name in columns * angles)):
            yield from _units(file, names, factors)
