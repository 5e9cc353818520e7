"""beacons.csv, ranges.csv, usbl.csv, ship.csv, sound-speed.csv: places of beacons, ranges and directions by sound.

    r = c (t - turn_around) / ways                       a travel time t as a range
    p_s = (1 - k) p_0 + k p_1,   k = (t - t_0) / (t_1 - t_0)     the ship between two rows, and so its angles

The pose of the ship at a row of usbl.csv is a variable of kind ``s`` that is held: it costs nothing in the solution.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from factors import BearingRange, Diagonal, Prior, Range, ScaledRange
from factors.base import Factor
from factors.keys import kinds
from models import SE3, R, euler
from models.algebra import Array, Index, Mask, Numbers
from models.errors import GraphFileError
from models.listing import some as listed
from nls.graph import FactorGraph
from nls.io.report import Source
from nls.missions.folder.calibration import Spaces
from nls.missions.folder.columns import ANGLES, PLACE, USBL, suffixed
from nls.missions.folder.fixes import horizontal
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.rows import Assembly, arms, columns_together
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline, leave_out, one_of

x, b, s = kinds("x", "b", "s")
SCALE, USBL_SCALE, USBL_YAW = "sound_speed_scale", "usbl_scale", "usbl_yaw_rad"


class Acoustics:
    """Acoustic measurements: their factors, added to a graph, and the variables they need.

    Parameters
    ----------
    mission, timeline : which get factors and their lines.
    depth : (n,) of the poses, m, in the order of their numbers.

    Attributes
    ----------
    numbers : (m,) of the beacons that were measured, rising.
    places : (m, 3) where they are by beacons.csv, nan where it does not say.
    ship : (k, 7) poses of the ship, variables ``s`` that are held.
    ship_twist : (k, 6) how they move, m/s and rad/s, in their own axes.

    Raises
    ------
    GraphFileError
        Columns that do not fit together, no such pose, time or ship, a range that cannot be.
    """

    def __init__(self, mission: Assembly, timeline: Timeline, depth: Array) -> None:
        self._mission, self._timeline = mission, timeline
        self._report, self._tables = mission.report, mission.tables
        measured = {name: mission.tables[name] for name in ("ranges", "usbl") if name in mission.tables}
        rows = {name: timeline.poses(name, table) for name, table in measured.items()}
        beacons = [table.integers("beacon")[rows[n][1]] for n, table in measured.items() if table.has("beacon")]
        self.numbers: Numbers = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *beacons]))
        self.places = np.full((len(self.numbers), 3), np.nan)
        self._shifts: list[str] = []
        self.ship, self.ship_twist = np.zeros((0, SE3.size)), np.zeros((0, SE3.dim))
        if "beacons" in self._tables:
            self._beacons(self._tables["beacons"])
        if "ranges" in measured:
            self._ranges(measured["ranges"], *rows["ranges"], depth)
        if "usbl" in measured:
            self._usbl(measured["usbl"], *rows["usbl"])
        self._unused()

    def shift(self) -> None:
        """Put the factors of usbl.csv under a `Shifted` of each of its calibrations that is a variable."""
        factors, calibrations = self._mission.graph.factors, self._mission.calibrations
        for name in self._shifts:
            for k in self._mission.of_table("usbl"):
                z = factors[k].z
                G = np.array([-1.0, 0, 0]) if name == USBL_YAW else z * [0.0, 0, 1] / (1 + calibrations.value(name))
                factors[k] = calibrations.shifted(factors[k], name, np.broadcast_to(G, z.shape))

    def spaces(self) -> Spaces:
        """The beacons and the ship, for `nls.Values`; a beacon of unknown place at 0."""
        out: Spaces = {}
        if len(self.numbers):
            out[b] = (R(3), np.nan_to_num(self.places), self.numbers)
        if len(self.ship):
            out[s] = (SE3, self.ship, np.arange(len(self.ship)))
        return out

    @property
    def absolute(self) -> list[str]:
        """The files among them that say where in the world the vehicle is."""
        placed = bool(np.isfinite(self.places).all(axis=1).any())
        return ["beacons.csv"] * placed + ["ship.csv"] * bool(len(self.ship))

    def _beacons(self, table: Table) -> None:
        """Priors of the beacons: their place, or their depth alone."""
        ids = table.unique("beacon", "beacon")
        z, sigmas, sigmas_xy = table.measured("z_m"), table.positive("sigma_z_m"), suffixed(PLACE[:2])
        components: tuple[str, ...] | None = ("z",)
        if table.has("x_m") or table.has("lat_deg") or columns_together(table, *sigmas_xy):
            z = np.hstack([horizontal(table, self._report.plane), z])
            if not columns_together(table, *sigmas_xy):
                raise table.at_names("has positions without their sigma_x_m and sigma_y_m")
            components, sigmas = None, np.hstack([table.positive(*sigmas_xy), sigmas])
        used = np.isin(ids, self.numbers)
        if not used.all():
            rest = f"of {len(ids)} beacons that nothing measures, the first is {ids[~used][0]}: not used"
            self._report.notes.append(f"beacons.csv has {int((~used).sum())} {rest}")
        if used.any():
            rows, first = np.flatnonzero(used), 2 if components else 0
            self.places[np.searchsorted(self.numbers, ids[rows]), first:] = z[rows]
            value = np.pad(z[rows], ((0, 0), (first, 0)))
            prior = Prior(b[ids[rows]], value, Diagonal(sigmas[rows]), components=components)
            self._mission.add(prior, table.source(rows))

    def _ranges(self, table: Table, poses: Numbers, rows: Mask, depth: Array) -> None:
        calibrations = self._mission.calibrations
        beacon, mount = table.integers("beacon"), _mount(table)
        if one_of(table, ("range_m", "sigma_range_m"), ("travel_time_s", "sigma_travel_time_s")):
            for name in filter(table.has, ("turn_around_s", "ways")):
                raise table.at_names(f"has range_m and {name}, which is of travel_time_s; leave it out")
            table.measured("range_m")  # within what a meter may be
            z, sigmas = table.positive("range_m")[:, 0], table.positive("sigma_range_m")[:, 0]
        else:
            z, sigmas = self._meters(table, poses[:, 0], beacon, depth)
        scale, size = calibrations.variable(SCALE), 1 + calibrations.value(SCALE)
        pose, target = x[poses[:, 0]], b[beacon]
        if scale is None:
            factor: Factor = Range(pose, target, z / size, Diagonal((sigmas / size)[:, None]), mount)
        else:
            factor = ScaledRange(pose, target, scale, z, Diagonal(sigmas[:, None]), mount)
        self._mission.add_rows(table, rows, factor)

    def _meters(self, table: Table, poses: Numbers, beacon: Numbers, depth: Array) -> tuple[Array, Array]:
        """Ranges (n,) and their standard deviations from travel times, m."""
        t, sigma = table.measured("travel_time_s")[:, 0], table.positive("sigma_travel_time_s")[:, 0]
        wait = table.measured("turn_around_s")[:, 0] if table.has("turn_around_s") else np.zeros(len(t))
        ways = table.integers("ways") if table.has("ways") else np.full(len(t), 2)
        expected = "expected 1, or 2 where the sound went there and back"
        table.refuse_rows(~np.isin(ways, (1, 2)), lambda k: f"ways is {ways[k]}; {expected}")
        table.refuse_numbers(wait < 0, wait, "seconds, 0 or more", "turn_around_s")
        more, short = "s are the turn-around; expected more than that", t - wait <= 0
        table.refuse_rows(short, lambda k: f"travel_time_s is {float(t[k])!r}, of which {float(wait[k])!r} {more}")
        c: Array | float = 1500.0  # m/s
        if (profile := self._tables.get("sound-speed")) is None:
            self._report.notes.append(f"there is no sound-speed.csv: travel times at {c:g} m/s")
        else:
            at = depth[np.minimum(np.searchsorted(self._timeline.numbers, poses), len(depth) - 1)]
            to = self.places[np.minimum(np.searchsorted(self.numbers, beacon), len(self.numbers) - 1), 2]
            if (unknown := np.isnan(to)).any():
                reason = "the speed of sound is taken at the depth of the vehicle"
                self._report.notes.append(f"no depth of beacon {beacon[unknown][0]} in beacons.csv: {reason}")
            c = mean_speed(profile, at, np.where(unknown, at, to))
        return c * (t - wait) / ways, c * sigma / ways

    def _usbl(self, table: Table, poses: Numbers, rows: Mask) -> None:
        calibrations = self._mission.calibrations
        table.positive("range_m")
        z = table.measured(*USBL)[:, [1, 2, 0]]  # azimuth, elevation, range
        steep = ~(np.abs(z[:, 1]) <= np.pi / 2)
        table.refuse_numbers(steep, z[:, 1], "radians, -pi/2 to pi/2, down is positive", "elevation_rad")
        noise, mount = table.positive(*suffixed(USBL))[:, [1, 2, 0]], _mount(table)
        z[:, 0] += calibrations.value(USBL_YAW)
        for ranges in (z, noise):
            ranges[:, 2] /= 1 + calibrations.value(USBL_SCALE)
        self._shifts = [name for name in (USBL_YAW, USBL_SCALE) if calibrations.variable(name) is not None]
        if table.has("beacon"):
            to_beacons = BearingRange(x[poses[:, 0]], b[table.integers("beacon")], z, Diagonal(noise), mount)
            return self._mission.add_rows(table, rows, to_beacons)
        if mount is not None:
            center = "whose transponder is taken to be at its center; leave arm_x_m, arm_y_m and arm_z_m out, or 0"
            cure = "or write positions of the transponder to fixes.csv, which has a lever arm"
            raise table.at_names(f"the ship measured the vehicle, {center}, {cure}")
        place, rows = self._ship(table, poses[:, 0], rows)
        self._mission.graph.fix(s[np.arange(len(self.ship))])
        return self._mission.add_rows(table, rows, BearingRange(s[place], x[poses[:, 0]], z, Diagonal(noise)))

    def _ship(self, table: Table, poses: Numbers, rows: Mask) -> tuple[Index, Mask]:
        """The number of the pose of the ship (n,) of every row, and which rows (n,) have one."""
        if (ship := self._tables.get("ship")) is None:
            cure = "write ship.csv with the poses of its transceiver, or name the beacon"
            raise table.at_names(f"has no column beacon, so the ship measured the vehicle; {cure}")
        t_s = ship.rising("time_s")
        rpy = np.unwrap(ship.attitude(*ANGLES), axis=0)
        p = np.column_stack([horizontal(ship, self._report.plane), ship.measured("z_m")])
        rowed = self._mission.times.get("usbl")
        t = self._timeline.at(poses) if rowed is None else rowed[:, 0]
        inside = (t >= t_s[0]) & (t <= t_s[-1])
        if (away := rows & ~inside).any():
            span = f"the times of ship.csv, {float(t_s[0])!r} to {float(t_s[-1])!r} s"
            leave_out(table, away, not (rows & inside).any(), float(t[np.argmax(away)]), span, self._report)
        rows = rows & inside

        def pose(t: Array) -> Array:
            return euler.to_se3(np.column_stack([np.interp(t, t_s, column) for column in np.hstack([rpy, p]).T]))

        self.ship = pose(t[rows])
        moment = 0.5  # s, before and after, over which the ship moves
        before, after = np.maximum(t[rows] - moment, t_s[0]), np.minimum(t[rows] + moment, t_s[-1])
        step = SE3.local(pose(before), pose(after))
        self.ship_twist = step / np.maximum(after - before, moment)[:, None]
        return np.cumsum(rows) - 1, rows

    def _unused(self) -> None:
        """Files without effect."""
        ranges, usbl = self._tables.get("ranges"), self._tables.get("usbl")
        for name, needed in (
            ("beacons", len(self.numbers) > 0),
            ("sound-speed", ranges is not None and ranges.has("travel_time_s")),
            ("ship", usbl is not None and not usbl.has("beacon")),
        ):
            if name in self._tables and not needed:
                self._report.notes.append(f"{name}.csv is not used: nothing in this mission needs it")
        unknown = self.numbers[np.isnan(self.places[:, 2])]
        if len(unknown):
            names = listed([str(number) for number in unknown])
            beacons = f"beacon {names} is" if len(unknown) == 1 else f"beacons {names} are"
            level = "On a track of one depth a beacon above fits as well; a row of beacon, z_m and sigma_z_m decides"
            start = "estimated, with an initial guess below the vehicle"
            self._report.notes.append(f"{beacons} not in beacons.csv: {start}. {level}")


def _mount(table: Table) -> Array | None:
    """Poses (n, 7) of the transducer on the vehicle, along its axes; None where it is at its center."""
    if (arm := arms(table)) is None:
        return None
    mount = SE3.identity(len(arm))
    mount[:, :3] = arm
    return mount


def mean_speed(table: Table, a: Array, b: Array) -> Array:
    """Harmonic mean (n,) of the speeds of sound between depths a and b (n,), m/s, by sound-speed.csv.

    A sound that goes straight from depth a to depth b needs, over each meter of depth, a time in proportion to 1/c(z):

        c = (b - a) / (S(b) - S(a)),   S(z) = int dz / c(z)

    the harmonic mean. Between two rows c is on the line between them, with the gradient g: S grows by
    ln(c_1 / c_0) / g. Above the first row and below the last one c is that of the row. The bending of the ray is left
    out. It makes the way longer by a fraction of (g L / c)^2 / 24, 2e-6 over 1 km with 0.01 1/s.

    Source: H. Medwin, C. Clay, Fundamentals of Acoustical Oceanography, 1998, section 3.3.

    Raises
    ------
    GraphFileError
        Depths that do not rise, a speed that no water has.
    """
    zs, c = table.rising("z_m"), table.measured("sound_speed_m_s")[:, 0]
    wrong = (c < 300) | (c > 3000)  # m/s: of sound in air, and faster than in any water
    table.refuse_numbers(wrong, c, "m/s, near 1500 in water", "sound_speed_m_s")
    change = np.diff(c)
    mean = change / np.where(change == 0, 1.0, np.log1p(change / c[:-1]))  # no cancellation where it is small
    S_rows = np.append(0.0, np.cumsum(np.diff(zs) / np.where(change == 0, c[:-1], mean)))

    def time(z: Array) -> Array:
        """S(z) (n,), s, from the first row."""
        k = np.clip(np.searchsorted(zs, z, side="right") - 1, 0, max(len(zs) - 2, 0))
        inside = np.clip(z, zs[0], zs[-1])
        change = np.interp(inside, zs, c) - c[k]
        slowness = np.where(change == 0, 1 / c[k], np.log1p(change / c[k]) / np.where(change == 0, 1.0, change))
        S = S_rows[k] + (inside - zs[k]) * slowness
        return np.asarray(S + np.minimum(z - zs[0], 0.0) / c[0] + np.maximum(z - zs[-1], 0.0) / c[-1])

    away = np.abs(b - a) > 1e-3  # m: depths that are one
    return np.where(away, (b - a) / np.where(away, time(b) - time(a), 1.0), np.interp(a, zs, c))


# --- beacons that several dives know ----------------------------------------------------------------------------------

Survey = tuple[int, tuple[float, ...]]  # a row of beacons.csv: the beacon, x, y, z and their sigmas, infinite for none


def _surveys(factors: Sequence[Factor]) -> Iterator[tuple[int, int, Survey]]:
    """The rows of beacons.csv among factors, each with the numbers of its factor and of its row there."""
    for k, prior in enumerate(factors):
        if isinstance(prior, Prior) and prior.keys[0].kind == b.name:
            assert isinstance(prior.noise, Diagonal)  # read from a table
            sigmas = np.full((len(prior), 3), np.inf)
            sigmas[:, 2 if prior.components else 0 :] = prior.noise.sigmas
            numbers = np.hstack([np.where(np.isfinite(sigmas), prior.z, 0.0), sigmas]).tolist()
            for row, (beacon, words) in enumerate(zip(prior.keys[0].numbers.tolist(), numbers, strict=True)):
                yield k, row, (beacon, tuple(words))


def refuse_moved_beacons(dives: Sequence[tuple[FactorGraph, MissionReport]]) -> None:
    """Refuse beacons that two dives have in different places, by the components that both measure.

    Raises
    ------
    GraphFileError
    """
    known: dict[int, list[tuple[Array, str]]] = {}
    for graph, report in dives:
        for k, row, (beacon, numbers) in _surveys(graph.factors):
            survey, place = np.reshape(numbers, (2, 3)), report.place(k, row)
            for other, where in known.setdefault(beacon, []):
                sigma = np.hypot(survey[1], other[1])
                away = np.where(np.isfinite(sigma), survey[0] - other[0], 0.0)
                if (np.abs(away) > 5 * sigma).any():
                    path, _, line = place.rpartition(":")
                    cure = "the same number is the same beacon, so give another one a number of its own"
                    apart = f"beacon {beacon} is {np.linalg.norm(away):.4g} m from where {where} has it"
                    raise GraphFileError(f"{apart}; {cure}", path, int(line))
            known[beacon].append((survey, place))


def without_known_beacons(own: FactorGraph, report: MissionReport, others: Sequence[Factor]) -> FactorGraph:
    """A dive without rows of its beacons.csv that the factors of others have word by word: one survey counts once."""
    known = {survey for _, _, survey in _surveys(others)}
    new: dict[int, list[int]] = {}
    for k, row, survey in _surveys(own.factors):
        new.setdefault(k, []).extend([row] if survey not in known else [])
    factors, sources = list(own.factors), list(report.sources)
    for k, rows in sorted(new.items(), reverse=True):
        if twice := len(factors[k]) - len(rows):
            report.notes.append(f"beacons.csv has {twice} rows that another dive has, too: counted once")
            factors[k : k + 1] = [factors[k][np.array(rows)]] if rows else []
            sources[k : k + 1] = [Source(sources[k].path, sources[k].lines[rows])] if rows else []
    report.sources = sources
    return FactorGraph(factors, own.fixed)
