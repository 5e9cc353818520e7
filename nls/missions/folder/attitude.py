r"""ahrs.csv, gyro.csv, depth.csv, pressure.csv: attitude and depth of a raw log, and holes in a log.

**A compass.** A reading is the heading at its time less the declination D, at a clock that is late by c:

    z(t) = psi(t - c) - D,    Heading + G c - D,    G = -d psi / dt

`Heading` with `Shifted` of each of the two that is a variable; the clock shifts pitch, roll and the legs, too. The rate
is that of means over a second (or two rows) before and after a pose: the noise of single readings hardly counts.

**A gyro.** The yaw is the integral of the rate about the vertical, from 0 at its first row,

    d psi / dt = (w_y sin(roll) + w_z cos(roll)) / cos(pitch)

and is no measurement of the heading. The step from pose to pose has its turn, with the variance sigma_w^2 dt of white
noise. It has a bias b, the same for a minute, which then walks: `Shifted` by G = dt. A turn with an error that is new
at every time swings the way (x, y) of its leg, by half and a third of its variance:

    cov(yaw) = q,    cov((x, y), yaw) = q/2 (-y, x)',    cov((x, y)) = q/3 (-y, x)'(-y, x)

**Holes** in the log of an attitude or depth sensor: what its values are there, and how well they are known.
A hole is more time between two rows than twice the median step, as for the DVL. Within one, from t_a to t_b = t_a + T,
a value y is taken along the straight line between the rows before and after it. How far the true one wanders from that
is not known; it is taken from the same log, as a Brownian bridge of density

    beta = 2 max(rms d, |y_b - y_a| / 2) / sqrt(T)

where d is measured elsewhere in the log, over times as long as the hole. It is the distance of the value in the middle
from the mean of the values at the ends. The second number is there as nothing says *when* in the hole the change was
made. In the middle of the hole the value has the standard deviation max(rms d, |y_b - y_a| / 2), at its ends none but
that of a row.

Poses in one hole share the error of its line. A factor of each cannot say so, and each counts with the sum of its
covariances with all of them, K(s, t) = beta^2 s (T - t) / T for s <= t since t_a, so that no combination of them is
better known than it is (`models.dead_reckoning.drop_outs` has the argument).

**Depths**: depth.csv as it is, or pressure.csv by the density or the latitude of water.csv.

The tide is subtracted: depths are below the level that tide.csv counts from, such as chart datum, and not below the
surface.
"""

from dataclasses import dataclass, field

import numpy as np

from factors import Between, Diagonal, Heading, Isotropic, Prior, Shifted
from factors.base import Factor
from factors.keys import Keys, Kind
from models import wrap
from models.algebra import Array, Index, Mask
from models.dead_reckoning.drop_outs import bridged_variance, longest_step, losses
from models.errors import GraphFileError
from models.pressure import ATMOSPHERE, depth_by_density, depth_unesco
from nls.missions.folder.calibration import Calibrations
from nls.missions.folder.columns import ANGLES, GYRO
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.rows import one_row
from nls.missions.folder.table import Table

ROUNDING = 1e-9  # of a step: times that are told apart
CLOCK = "ahrs_clock_s"


@dataclass(frozen=True)
class Attitude:
    """Roll, pitch and yaw as measured.

    Attributes
    ----------
    ahrs : the table of roll and pitch.
    t_a : (m,) its times, s, with the stated calibration of the clock.
    tilt : (m, 2) roll and pitch, rad.
    t : (k,) times of all three angles, s: those of the table, or of the gyro.
    rpy : (k, 3) angles at t, no turn missing, rad.
    gyro : where there is no compass: its table, and d psi / dt (k,) at t, rad/s.
    """

    ahrs: Table = field(repr=False)
    t_a: Array = field(repr=False)
    tilt: Array = field(repr=False)
    t: Array = field(repr=False)
    rpy: Array = field(repr=False)
    gyro: tuple[Table, Array] | None = field(default=None, repr=False)

    def rates(self, b: Array) -> Array:
        """Rates (n, 3) of roll, pitch and yaw at times b (n,), rad/s."""
        return np.column_stack([_rate(self.t, angle, b) for angle in self.rpy.T])

    def tilting(self, b: Array) -> Array:
        """Rates (n, 3) of pitch and roll at times b (n,), behind a depth that stays, as `factors.ZPR` has them."""
        return np.column_stack([np.zeros(len(b)), self.rates(b)[:, [1, 0]]])

    def at(self, t: Array) -> Array:
        """Roll, pitch and yaw (n, 3) at times t (n,); before the first and after the last row those of it."""
        return np.column_stack([np.interp(t, self.t, angle) for angle in self.rpy.T])


def attitude_of(tables: dict[str, Table], calibrations: Calibrations) -> Attitude:
    """The attitude of ahrs.csv, or of ahrs.csv without a yaw and gyro.csv; beside motion.csv what is not there is 0.

    Raises
    ------
    GraphFileError
        Both or neither say how the yaw goes; times that do not rise; angles that cannot be.
    """
    ahrs, gyro = tables["ahrs"], tables.get("gyro")
    t_a = ahrs.rising("time_s")
    if ahrs.has("yaw_rad") or "motion" in tables:
        if gyro is not None:
            cure = "leave gyro.csv out, or that column"
            raise GraphFileError(f"gives the yaw, and ahrs.csv has a column yaw_rad; {cure}", gyro.path)
        angles = [ahrs.attitude(name) if ahrs.has(name) else np.zeros((len(ahrs), 1)) for name in ANGLES]
        rpy, t_a = np.unwrap(np.hstack(angles), axis=0), t_a - calibrations.value(CLOCK)
        return Attitude(ahrs, t_a, rpy[:, :2], t_a, rpy)
    if gyro is None:
        cure = "one of the two must give the yaw"
        raise GraphFileError(f"has no column 'yaw_rad', and there is no gyro.csv; {cure}", ahrs.path)
    tilt = np.unwrap(ahrs.attitude(*ANGLES[:2]), axis=0)
    t, w = gyro.rising("time_s"), gyro.measured("wx_rad_s", "wy_rad_s", "wz_rad_s")
    roll, pitch = (np.interp(t, t_a, angle) for angle in tilt.T)
    rate = (w[:, 1] * np.sin(roll) + w[:, 2] * np.cos(roll)) / np.cos(pitch)
    yaw = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))
    return Attitude(ahrs, t_a, tilt, t, np.column_stack([roll, pitch, yaw]), (gyro, rate))


def headings(attitude: Attitude, poses: Keys, b: Array, sigma: Array, calibrations: Calibrations) -> Factor:
    """Headings of poses at times b (n,) by the compass, with sigmas (n,), clock and declination."""
    yaw = np.interp(b, attitude.t, attitude.rpy[:, 2])
    declination = calibrations.variable("declination_rad")
    if declination is None:
        yaw = yaw + calibrations.value("declination_rad")
    heading = Heading(poses, wrap(yaw)[:, None], Isotropic(sigma))
    compass = calibrations.shifted(heading, CLOCK, -attitude.rates(b)[:, 2:])
    return compass if declination is None else Shifted(compass, [[-1.0]], declination)


def _rate(t: Array, y: Array, b: Array) -> Array:
    """Rates (n,) of y (m,) at times b: the mean after less the mean before, over half of the time of both."""
    total = np.append(0.0, np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t)))

    def integral(s: Array) -> Array:
        k = np.minimum(np.searchsorted(t, s, side="right") - 1, len(t) - 2)
        return np.asarray(total[k] + 0.5 * (y[k] + np.interp(s, t, y)) * (s - t[k]))

    reach = max(1.0, longest_step(t))  # s
    low, high = np.maximum(b - reach, t[0]), np.minimum(b + reach, t[-1])
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.asarray((integral(high) - 2 * integral(middle) + integral(low)) / half**2)


def turn_covariance(attitude: Attitude, b: Array, xyh: Array, sigma_w: float, notes: list[str]) -> Array:
    """Covariances (n - 1, 3, 3) of x, y and yaw of legs (n - 1, 3) by a gyro, whose error is new at every time.

    The variance of the turn is larger over holes in the log of the gyro.
    """
    assert attitude.gyro is not None
    q, t, (gyro, rate) = sigma_w**2 * np.diff(b), attitude.t, attitude.gyro
    effect = "turn evenly from row to row, with a larger sigma"
    beta = holes_of(gyro, t, rate[:, None], b, effect, notes).density[:, 0]
    for a in np.flatnonzero(beta):
        inside = np.clip(b, t[a], t[a + 1]) - t[a]
        q += beta[a] ** 2 * bridged_variance(inside[:-1], inside[1:], np.full(len(q), t[a + 1] - t[a]))
    swing = np.column_stack([-xyh[:, 1], xyh[:, 0]])
    Sigma = np.empty((len(q), 3, 3))
    Sigma[:, :2, :2] = swing[:, :, None] * swing[:, None, :] / 3
    Sigma[:, :2, 2] = Sigma[:, 2, :2] = swing / 2
    Sigma[:, 2, 2] = 1.0
    return np.asarray(q[:, None, None] * Sigma)


def gyro_biases(b: Array, noise: dict[str, float], calibrations: Calibrations) -> tuple[Keys, list[Factor]]:
    """The bias (n - 1,) of every leg between poses at times b (n,), and what is known of the biases."""
    bias, minute = Kind("gyro_bias"), 60.0  # s that a gyro has the same bias
    numbers, of_legs = np.unique(((b[:-1] - b[0]) / minute).astype(int), return_inverse=True)
    calibrations.add(bias, len(numbers), noise[GYRO[1]])
    known: list[Factor] = [Prior(bias[0], [0.0], Diagonal([noise[GYRO[1]]]))]
    if len(numbers) > 1:
        walk = noise[GYRO[2]] * np.sqrt(minute * np.diff(numbers))
        k = np.arange(len(numbers))
        known.append(Between(bias[k[:-1]], bias[k[1:]], np.zeros((len(walk), 1)), Isotropic(walk)))
    return bias[of_legs], known


# --- holes in a log ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Holes:
    """The holes of one log and the poses in them.

    Attributes
    ----------
    inside : (n,) whether a pose is in a hole.
    density : (m, c) beta after each of m rows and for each of c values, 0 where no hole follows.
    sigma : (n, c) standard deviation of a value at each pose by the hole it is in, 0 outside.
    """

    inside: Mask
    density: Array
    sigma: Array


def holes_of(table: Table, t: Array, y: Array, b: Array, effect: str, notes: list[str]) -> Holes:
    """The holes of a log that poses lie in or beside, each known as well as the rest of the log allows.

    Parameters
    ----------
    table : for messages, with its m rows at t (m,), s, and their values y (m, c), no turn missing in angles.
    b : (n,) times of the poses, rising, s.
    effect : what a note says of the poses in a hole.
    notes : get the note.

    Raises
    ------
    GraphFileError
        A hole so long that no time as long without one is left to judge it by.
    """
    a = np.flatnonzero(losses(t, np.ones(len(t), dtype=bool)) & (t < b[-1]))
    a = a[t[a + 1] > b[0]]
    T, density = t[a + 1] - t[a], np.zeros_like(y)
    step = longest_step(t) / 2
    length = np.ceil(T / step - ROUNDING) * step
    for L in np.unique(length):
        d = _from_the_middle(t, y, float(L))
        rows = a[length == L]
        if not len(d):
            none = f"no row in the {t[rows[0] + 1] - t[rows[0]]:.6g} s before this one"
            rest = "no equally long time without a hole shows how far the vehicle turns or dives"
            raise table.at(int(rows[0]) + 1, f"{none}, and {rest}; cut the log in two here")
        most = np.maximum(np.sqrt(np.square(d).mean(axis=0)), np.abs(y[rows + 1] - y[rows]) / 2)
        density[rows] = 2 * most / np.sqrt(t[rows + 1] - t[rows])[:, None]

    inside, sigma = np.zeros(len(b), dtype=bool), np.zeros((len(b), y.shape[1]))
    if len(a):
        hole = np.searchsorted(t[a], b, side="right") - 1  # the last one that began before, -1 for none
        since = b - t[a][hole]
        inside = (hole >= 0) & (since > 0) & (b < t[a + 1][hole])
        shared = _shared(since[inside], T[hole[inside]], hole[inside])
        sigma[inside] = density[a[hole[inside]]] * np.sqrt(shared)[:, None]
        k = int(np.argmax(T))
        many = f"{len(a)} holes, {T.sum():.6g} s in all, the longest" if len(a) > 1 else "a hole"
        reason = f"{many} between {t[a[k]]:.6g} and {t[a[k] + 1]:.6g} s: {int(inside.sum())} of {len(b)} poses {effect}"
        notes.append(f"{table.place(int(a[k]) + 1)}: {reason}")
    return Holes(inside, density, sigma)


def _from_the_middle(t: Array, y: Array, length: float) -> Array:
    """Values (k, c) in the middle of times of this length without a hole, less the mean of the values at their ends."""
    a = np.flatnonzero(losses(t, np.ones(len(t), dtype=bool)))
    slack = ROUNDING * length
    begin, end = t - length / 2 + slack, t + length / 2 - slack
    clear = np.searchsorted(t[a + 1], begin, side="right") == np.searchsorted(t[a], end, side="left")
    clear &= (begin >= t[0]) & (end <= t[-1])
    ends = [np.column_stack([np.interp(s[clear], t, column) for column in y.T]) for s in (begin, end)]
    return np.asarray(y[clear] - 0.5 * (ends[0] + ends[1]))


def _shared(since: Array, T: Array, hole: Index) -> Array:
    """Sum over all poses l in the same hole of s (T - t) / T, s and t the earlier and later of the poses k and l.

    Parameters
    ----------
    since : (m,) times since the hole began, rising within a hole; T : (m,) its length; hole : (m,) rising.
    """
    first = np.searchsorted(hole, hole)
    last = np.searchsorted(hole, hole, side="right") - 1

    def up_to(x: Array) -> Array:
        """Sum of x over the poses of the hole up to each."""
        total = np.cumsum(x)
        return np.asarray(total - (total - x)[first])

    after = T - since
    later = up_to(after)[last] - up_to(after)
    return np.asarray((after * up_to(since) + since * later) / T)


def depths_of(tables: dict[str, Table], report: MissionReport) -> tuple[Table, Array, Array]:
    """The table of depths or pressures, its times (n,), s, and the depths (n, 1), m.

    Raises
    ------
    GraphFileError
        Times that do not rise; nothing that says how heavy the water is; a tide that is not known at all times.
    """
    if (depth := tables.get("depth")) is not None:
        for name in ("water", "tide"):
            if name in tables:
                raise tables[name].at(0, f"depth.csv has depths; {name}.csv is for pressure.csv, leave it out")
        return depth, depth.rising("time_s"), depth.measured("z_m")
    pressure = tables["pressure"]
    t, p = pressure.rising("time_s"), pressure.measured("pressure_pa")
    z = _depth(pressure, p, tables.get("water"), report)
    if (tide := tables.get("tide")) is not None:
        times, height = tide.rising("time_s"), tide.measured("tide_m")[:, 0]
        if t[0] < times[0] or t[-1] > times[-1]:
            rest = f"pressure.csv lasts from {float(t[0])!r} to {float(t[-1])!r} s; give a row before and one after it"
            raise tide.at(0, f"the tide is known from {float(times[0])!r} to {float(times[-1])!r} s, and {rest}")
        z = z - np.interp(t, times, height)[:, None]
    if (above := z[:, 0] < -1).any():  # m: waves and weather
        k = int(np.argmax(above))
        cure = "is it relative to the atmosphere? Then atmosphere_pa of water.csv is 0"
        report.warn(f"{pressure.place(k)}: pressure_pa gives {-float(z[k, 0]):.3g} m above the surface; {cure}")
    return pressure, t, z


def _depth(pressure: Table, p: Array, water: Table | None, report: MissionReport) -> Array:
    """Depths (n, 1) below the surface."""
    given: dict[str, float] = {}
    if water is not None:
        given = one_row(water)
        water.measured(*water.names)  # within what their units allow
        if given.keys() >= {"density_kg_m3", "latitude_deg"}:
            raise water.at(0, "density_kg_m3 and latitude_deg both give the density of the water; remove one of them")
    if "atmosphere_pa" not in given:
        cure = "atmosphere_pa of water.csv says it"
        report.notes.append(f"pressure.csv: {ATMOSPHERE:.0f} Pa of it are taken for the atmosphere; {cure}")
    above = p - given.get("atmosphere_pa", ATMOSPHERE)
    if (density := given.get("density_kg_m3")) is not None:
        assert water is not None
        water.positive("density_kg_m3")
        return depth_by_density(above, density)
    latitude = given.get("latitude_deg")
    if latitude is None and report.plane is not None:
        latitude = report.plane.lat
        report.notes.append(f"pressure.csv: depths by the formula of UNESCO at {latitude:.6g} degrees, of origin.csv")
    if latitude is None:
        cure = "add water.csv, one row with density_kg_m3, or with latitude_deg for sea water by the formula of UNESCO"
        raise pressure.at(0, f"nothing gives the density of the water; {cure}")
    if abs(latitude) > 90:
        assert water is not None
        raise water.at(0, f"latitude_deg is {latitude!r}; expected -90 to 90")
    return depth_unesco(above, latitude)
