r"""Tracks that no DVL measures: odometry.csv and zpr.csv, path.csv, motion.csv; `nls.missions.folder.dvl` has others.

`path.csv` holds poses that a program or a vehicle has reckoned, which drift. What it says are the steps between them,

    XYH = h(X_i, X_i+1),    ZPR = (z, pitch, roll),

with the standard deviations of a step in the row it leads to. Columns that are not there are held at 0: a vehicle on
the surface, or at a depth that does not matter.

`motion.csv` is of a vehicle whose motion no sensor measures, such as an ROV with a compass, a depth sensor and USBL.

Between the times of its positions the vehicle may be anywhere it can have gone. This is a random walk of density s,
m/sqrt(s), along the axes of the world,

    p_i+1 - p_i ~ N(0, s^2 (t_i+1 - t_i))    in x and y, and in z where no sensor measures the depth.

`Heading` and `ZPR` have the angles of ahrs.csv and the depth, on the lines between their rows. Poses that are denser
than the rows, and poses in a hole of a log, have larger sigmas, as those of a raw log have.

A pose in space has six numbers. Those that nothing measures are held at 0, with `HELD`. This is a gauge and no
measurement: nothing else depends on them, and their cells in the results are empty. A measurement along the axes of the
vehicle, as over a lever arm, needs all three angles, else it is refused.
"""

import numpy as np

from factors import XYH, ZPR, Diagonal, Heading, Landmark, Prior, SqrtInformation
from factors.base import Factor
from factors.keys import kinds
from models import SE3, euler
from models.algebra import Array, Numbers, wrap
from models.dead_reckoning.drop_outs import longest_step
from models.sensors import levelled
from nls.io.report import Source
from nls.missions.folder.attitude import CLOCK, attitude_of, depths_of, headings, holes_of
from nls.missions.folder.columns import ANGLES, ARM, COMPASS, LEVEL, PLACE, TILT, UPRIGHT, suffixed
from nls.missions.folder.rows import Assembly, Times, columns_together, noise_of, one_row
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import SAME_TIME, poses_of_rows, united
from nls.sparse.elimination import connected

AXES = {  # tables of what is measured along the axes of the vehicle
    "usbl": "is a direction from the vehicle;",
    "contacts": "has directions from the vehicle;",
    "closures": "has steps ahead and to starboard;",
}
HELD = 1e-3  # m and rad: sigma of a depth and a tilt that a file takes to be 0, or of what nothing measures
Column = tuple[Array, Array, Source]  # numbers (n,) and standard deviations (n,) at the poses, and their lines
Log = tuple[Table, Array, Array, tuple[str, ...]]  # its times (m,), numbers (m, k) and columns
(x,) = kinds("x")


def odometry(mission: Assembly) -> Numbers:
    """Numbers of the poses, rising; adds the factors of odometry.csv and zpr.csv."""
    tables, report = mission.tables, mission.report
    joins, zpr = tables["odometry"], tables["zpr"]
    i, j = joins.integers("i"), joins.integers("j")
    joins.refuse_rows(i == j, lambda k: f"the step connects pose {i[k]} to itself")
    numbers = np.unique(np.concatenate([i, j]))
    pieces = np.unique(connected(numbers.searchsorted(i), numbers.searchsorted(j), len(numbers)))
    if len(pieces) > 1:
        parts = f"{len(pieces)} pieces, the second begins at pose {numbers[pieces[1]]}"
        rest = "only landmarks that both saw, or an anchor of each, say where they are to each other; is a row missing?"
        report.warn(f"odometry.csv leaves the track in {parts}: {rest}")
    again = len(i) - len(np.unique(np.stack([i, j]), axis=1).T)
    if again:
        report.notes.append(f"odometry.csv measures {again} steps more than once: all of them count")
    tilted = zpr.unique("i", "pose")
    zpr.known("i", numbers, "odometry.csv has no such pose")
    if len(bare := np.setdiff1d(numbers, tilted)):
        report.warn(f"{len(bare)} poses have no row in zpr.csv, the first is {bare[0]}: their depth and tilt are free")
    if "poses" in tables:
        report.vertex_times["x"] = _times_of_poses(tables["poses"], numbers)
    steps = XYH(x[i], x[j], joins.measured(*LEVEL), Diagonal(joins.positive(*suffixed(LEVEL))))
    mission.add(steps, joins.source())
    mission.add(ZPR(x[tilted], zpr.attitude(*TILT), Diagonal(zpr.positive(*suffixed(TILT)))), zpr.source())
    if columns_together(zpr, *COMPASS):
        yaw, sigma = wrap(zpr.attitude(COMPASS[0])), Diagonal(zpr.positive(COMPASS[1]))
        mission.add(Heading(x[tilted], yaw, sigma), zpr.source())
    return numbers


def _times_of_poses(poses: Table, numbers: Numbers) -> Array:
    """Times (n,) of the poses, s, in the order of their numbers."""
    ids, t = poses.unique("i", "pose"), poses.rising("time_s")
    poses.known("i", numbers, "nothing measures this pose; leave it out")
    if len(missing := np.setdiff1d(numbers, ids)):
        cure = "give a time for every pose"
        raise poses.at(len(poses) - 1, f"this is the last row, and pose {missing[0]} has none; {cure}")
    return t[np.argsort(ids)]


def reckoned(mission: Assembly) -> Numbers:
    """Numbers of the poses, at the times of path.csv and of other files; adds `XYH` and `ZPR` between and at them.

    Between two rows the path is straight, and the variance of its step grows evenly.

    Raises
    ------
    GraphFileError
        Times that do not rise, one pose, numbers that cannot be.
    """
    path, report = mission.tables["path"], mission.report
    t_p = path.rising("time_s")
    if len(t_p) < 2:
        raise path.at(0, "one pose; a track has at least two")
    absent = [name for name in UPRIGHT if not path.has(name)]
    if absent:
        report.unmeasured = tuple(name.split("_")[0] for name in absent)
        report.notes.append(f"path.csv has no {', '.join(absent)}: taken as 0 and empty in the results")
    t = united(t_p, float(t_p[-1]), mission.times, mission.tables)
    numbers = np.arange(len(t))
    row = np.searchsorted(t_p, t)  # the first one that is not before
    state = {name: np.interp(t, t_p, _column(path, name, 0.0)) for name in (*ANGLES, *PLACE)}
    part = np.sqrt(np.diff(t) / np.diff(t_p)[row[1:] - 1])[:, None]
    X = euler.to_se3(np.column_stack([state[name] for name in (*ANGLES, *PLACE)]))
    step, _ = levelled(X[:-1], X[1:])
    sigmas = np.column_stack([_column(path, f"sigma_{name}", HELD)[row] for name in TILT])
    sigmas *= poses_of_rows(t_p, t)[:, None]
    report.vertex_times["x"] = t
    spread = Diagonal(path.positive(*suffixed(LEVEL))[row[1:]] * part)
    mission.add(XYH(x[numbers[:-1]], x[numbers[1:]], step, spread), path.source(row[1:]))
    tilts = np.column_stack([state[name] for name in TILT])
    mission.add(ZPR(x[numbers], tilts, Diagonal(sigmas)), path.source(row))
    return numbers


def _column(path: Table, name: str, absent: float) -> Array:
    """A column (n,) of the path: an angle without turns, a standard deviation above 0; a number where it is absent."""
    if not path.has(name):
        return np.full(len(path), absent)
    if name.startswith("sigma_"):
        return path.positive(name)[:, 0]
    column = path.attitude(name)[:, 0]
    return np.unwrap(column) if name in ANGLES else column


def walking(mission: Assembly) -> Numbers:
    """Numbers of the poses at the times of other files, rising; adds the walk between them, angles and depths at them.

    Raises
    ------
    GraphFileError
        A second row; fewer than two times; no sigma of a sensor; an angle that a measurement needs and none measures.
    """
    tables, report, calibrations = mission.tables, mission.report, mission.calibrations
    motion = tables["motion"]
    one_row(motion)
    density = float(motion.positive("sigma_walk_m_sqrt_s")[0, 0])
    logs: dict[str, Log] = {}
    if "ahrs" in tables:
        attitude = attitude_of(tables, calibrations)
        names = tuple(name for name in ANGLES if attitude.ahrs.has(name))
        if not names:
            raise attitude.ahrs.at_names(f"has times and no angle; expected one of {', '.join(ANGLES)}")
        logs["ahrs"] = attitude.ahrs, attitude.t, attitude.rpy[:, [ANGLES.index(name) for name in names]], names
    if cell := next((name for name in ("depth", "pressure") if name in tables), None):
        logs[cell] = (*depths_of(tables, report), ("z_m",))
    elif stray := [name for name in ("water", "tide") if name in tables]:
        raise tables[stray[0]].at(0, "is for pressure.csv, which is not there; leave it out")
    t = _times(motion, {name: t_log for name, (_, t_log, _, _) in logs.items()}, mission.times, tables)
    n, measured = len(t), dict[str, Column]()
    for name, log in logs.items():
        measured |= _interpolated(t, name, log, tables.get("noise"), report.notes)
    unknown = [name for name in ANGLES if name not in measured]
    z_elsewhere = bool({"ranges", "usbl"} & tables.keys()) or ("fixes" in tables and tables["fixes"].has("z_m"))
    _refuse_axes(tables, unknown)
    held = "z_m" not in measured and not z_elsewhere
    report.unmeasured = tuple(name.split("_")[0] for name in [*unknown, *["z_m"] * held])

    numbers, zero = np.arange(n), (np.zeros(n), np.full(n, HELD), motion.source(np.zeros(n, dtype=np.intp)))
    i, j, way = x[numbers[:-1]], x[numbers[1:]], density * np.sqrt(np.diff(t))
    columns = [measured.get(name, zero) for name in TILT]
    z, sigmas = np.column_stack([c[0] for c in columns]), np.column_stack([c[1] for c in columns])
    walk = XYH(i, j, np.zeros((n - 1, 3)), SqrtInformation(np.diag([1, 1, 0]) / way[:, None, None]))
    rises = z_elsewhere and "z_m" not in measured
    if rises:
        sigmas[:, 0] = np.inf
    zpr: Factor = ZPR(x[numbers], z, SqrtInformation((1 / sigmas)[:, :, None] * np.eye(3)))
    heading: Factor = Prior(x[numbers], SE3.identity(), Diagonal([HELD]), components=("yaw",))
    if "ahrs" in logs:
        zpr = calibrations.shifted(zpr, CLOCK, -attitude.tilting(t))
    if "yaw_rad" in measured:
        heading = headings(attitude, x[numbers], t, measured["yaw_rad"][1], calibrations)
    report.vertex_times["x"] = t
    tilt = next((measured[name] for name in TILT if name in measured), zero)
    walked = motion.source(np.zeros(n - 1, dtype=np.intp))
    mission.add(walk, walked)
    mission.add(zpr, tilt[2])
    mission.add(heading, measured.get("yaw_rad", zero)[2])
    if rises:
        W = SqrtInformation(np.diag([0, 0, 1]) / way[:, None, None])
        mission.add(Landmark(i, j, np.zeros((n - 1, 3)), W), walked)
    note = f"no sensor measures the motion: a random walk of {density:g} m in the first second, and by the root of more"
    report.notes.append(f"{note}, connects {n} poses at the times of the measurements")
    if report.unmeasured:
        note = f"nothing measures {', '.join(report.unmeasured)}: empty cells in trajectory.csv"
        report.notes.append(f"{note}; 0 in trajectory.tum, which has none")
    return numbers


def _times(motion: Table, logs: Times, times: Times, tables: dict[str, Table]) -> Array:
    """Times (n,) of the poses, s: those of the rows of other files while all logs last."""
    t = np.concatenate([np.zeros(0), *(rows.ravel() for rows in times.values())])
    for t_log in logs.values():
        t = t[(t >= t_log[0]) & (t <= t_log[-1])]
    t = united(t.min(keepdims=True), float(t.max()), times, tables) if len(t) else t
    if len(t) < 2:
        while_all = f" while all {len(logs)} logs of sensors last" if logs else ""
        spans = "".join(f"; {name}.csv has {y.min():.10g} to {y.max():.10g} s" for name, y in (logs | times).items())
        problem = f"fewer than two times of fixes or ranges{while_all}; a track has at least two poses{spans}"
        raise motion.at(0, problem)
    return t


def _interpolated(t: Array, name: str, log: Log, noise: Table | None, notes: list[str]) -> dict[str, Column]:
    """The columns of a log at times t (n,)."""
    table, t_log, y, names = log
    stated = {f"sigma_{column}": name for column in names}
    if noise is None:
        raise table.at_names(f"has no sigma; write noise.csv with one row of {', '.join(stated)}")
    sigma = np.array([noise_of(noise, stated)[column] for column in stated])
    sigmas = sigma * poses_of_rows(t_log, t)[:, None]
    after = np.clip(t_log.searchsorted(t), 1, len(t_log) - 1)
    hollow = np.minimum(t_log[after] - t, t - t_log[after - 1]) >= SAME_TIME
    hollow &= np.diff(t_log)[after - 1] > longest_step(t_log)
    if hollow.any():
        hole = holes_of(table, t_log, y, t[hollow], "lie on the line over it, with larger sigmas", notes)
        sigmas[hollow] = np.hypot(sigma, hole.sigma)
    source = table.source(t_log.searchsorted(t, side="right") - 1)
    return {column: (np.interp(t, t_log, y[:, k]), sigmas[:, k], source) for k, column in enumerate(names)}


def _refuse_axes(tables: dict[str, Table], unknown: list[str]) -> None:
    """Refuse what is measured along the axes of the vehicle where one of its angles is not measured."""
    for name, table in tables.items() if unknown else ():
        problem = AXES.get(name, "") if name != "usbl" or table.has("beacon") else ""
        if table.has(*ARM) and table.measured(*ARM).any():
            problem = "has a lever arm; leave the arm out, or"
        if problem:
            cure = f"{problem} write {' and '.join(unknown)} to ahrs.csv, which nothing measures beside motion.csv"
            raise table.at(0, f"{cure}: of a vehicle that is level, 0 with its sigma in noise.csv")
