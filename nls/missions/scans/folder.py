"""A folder of keyframes and scans: its files, and their contents: a graph of dead reckoning, points, a report.

mission.toml says how the sonar is mounted, and how wrong dead reckoning is:

[sonar]
azimuth = "left"       positive to the left, or "right"
x_m = 0.0              place of the sonar on the vehicle, x ahead, y to the left; also y_m
yaw_rad = 0.0          where it looks, positive to the left
[drift]                see `nls.missions.scans.Drift`: mean, stretch, length, step, yaw, heading
heading = false        no compass
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from models import SE2
from models.algebra import Array, Index, Numbers
from models.errors import GraphFileError
from models.listing import some
from models.options import did_you_mean, is_number
from nls.graph import FactorGraph
from nls.io.report import LoadReport, Source
from nls.io.unused_lines import note_comments
from nls.metrics import TrajectoryError, ate
from nls.missions.folder.columns import ALONE, LOG, TRACK, TURNS
from nls.missions.folder.folder import names_in, note_others
from nls.missions.folder.table import Table
from nls.missions.folder.toml_file import TomlFile
from nls.missions.scans import Drift, Scans, dead_reckoning
from nls.values import Values

COLUMNS: dict[str, tuple[str, ...]] = {
    "keyframes": ("keyframe", "time", "x", "y", "yaw"),
    "scans": ("keyframe", "range", "azimuth", "intensity"),
    "truth": ("time", "x", "y", "yaw"),
}
OPTIONAL: dict[str, tuple[str, ...]] = {"scans": ("intensity",), "truth": ("yaw",)}
NEEDED = ("keyframes", "scans")
SETTINGS = "mission.toml"
OTHER_MISSIONS = {*TRACK, *LOG, *ALONE} - {"odometry"}  # names of tables that a scan mission does not have
NOT_MISSED = (SETTINGS, "graph.npz", "truth.npz")
SIDES = {"left": 1.0, "right": -1.0}
MOUNT = ("x_m", "y_m", "yaw_rad")
SECTIONS = {"sonar": ("azimuth", *MOUNT), "drift": tuple(entry.name for entry in fields(Drift))}


@dataclass(frozen=True)
class Truth:
    """True poses at the times of keyframes.

    Attributes
    ----------
    rows : (m,) of the keyframes that lie within the times of the truth.
    poses : (m, 3) x, y, m, and yaw, rad; yaw 0 where the file has none.
    """

    rows: Index
    poses: Array = field(repr=False)

    def ate(self, poses: Array) -> TrajectoryError:
        """Absolute trajectory error of keyframes (count, 3) after one rigid motion without scale.

        Raises
        ------
        SingularGeometryError
            All keyframes on one spot.
        """
        return ate(poses[self.rows], self.poses, align="rigid")

    def onto(self, poses: Array) -> Values:
        """The true poses x, moved onto keyframes (count, 3) by the rigid motion of `ate`."""
        back = SE2.inverse(self.ate(poses).T[None])
        return Values({"x": (SE2, SE2.compose(np.repeat(back, len(self.poses), axis=0), self.poses), self.rows)})


@dataclass
class ScanReport(LoadReport):
    """The report of a scan mission; `vertex_times` has the times of its keyframes.

    Attributes
    ----------
    numbers : (count,) of the keyframes as in the file; keyframe k of graph and scans is its row, from 0.
    scans : the points in the frame of the vehicle.
    intensity : (n,) of the points, in their order; None where the file has none.
    drift : how wrong dead reckoning is taken to be.
    truth : None without a file of it.
    """

    numbers: Numbers = field(default_factory=lambda: np.zeros(0, dtype=np.int64), compare=False, repr=False)
    scans: Scans = field(default_factory=lambda: Scans(np.zeros((0, 2)), np.zeros(0, dtype=np.intp), 0), compare=False)
    intensity: Array | None = field(default=None, compare=False, repr=False)
    drift: Drift = field(default_factory=Drift)
    truth: Truth | None = field(default=None, compare=False)

    @property
    def counts(self) -> dict[str, int]:
        """Keyframes, scans with points in them, points, and keyframes within the truth."""
        return {
            "keyframes": len(self.numbers),
            "scans": int(self.scans.with_points.sum()),
            "points": len(self.scans.points),
            "keyframes_with_truth": 0 if self.truth is None else len(self.truth.rows),
        }


def file_of(folder: str | Path, table: str) -> Path | None:
    """The file of a table, plain or gzip-compressed; None without one."""
    names = (Path(folder, f"{table}.csv"), Path(folder, f"{table}.csv.gz"))
    return next((name for name in names if name.exists()), None)


def is_scan_mission(folder: str | Path) -> bool:
    """Whether a folder holds keyframes and scans, or one of the two and no table of another mission."""
    present = [file_of(folder, table) is not None for table in NEEDED]
    return all(present) or (any(present) and not any(file_of(folder, table) for table in OTHER_MISSIONS))


def read_scan_mission(folder: str | Path) -> tuple[FactorGraph, Values, Scans, ScanReport]:
    """The graph of dead reckoning of a scan mission, its start and its points; see the page on formats.

    Parameters
    ----------
    folder : with ``keyframes.csv`` and ``scans.csv``, and where they are known ``truth.csv`` and ``mission.toml``; the
        tables plain or gzip-compressed.

    Returns
    -------
    graph, values : of `nls.missions.scans.dead_reckoning`: keyframes x (SE2), numbered by their rows from 0.
    scans : the points, m, in the frame of the vehicle: x ahead, y to the left.
    report : the numbers of the keyframes in the file, their times, the intensities and the truth.

    Raises
    ------
    GraphFileError
        No scan mission, or one that cannot be right; says which file and line.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     keyframes, scans = Path(folder, "keyframes.csv"), Path(folder, "scans.csv")
    ...     _ = keyframes.write_text("keyframe,time,x,y,yaw\\n0,0,0,0,0\\n5,1,1,0,0\\n")
    ...     _ = scans.write_text("keyframe,range,azimuth\\n5,10,0.1\\n")
    ...     graph, values, scans, report = read_scan_mission(folder)
    >>> scans, report.numbers.tolist()
    (Scans(1 points in 1 of 2 keyframes), [0, 5])
    """
    tables, settings, report = _read_folder(folder)
    table = tables["keyframes"]
    numbers, times, poses = _keyframes(table)
    graph, values = dead_reckoning(poses, settings.drift)
    report.numbers, report.vertex_times, report.drift = numbers, {"x": times}, settings.drift
    report.scans, report.intensity = _scans(tables["scans"], numbers, settings)
    if "truth" in tables:
        report.truth = _truth(tables["truth"], times, report)
    of_steps, nowhere = table.source(slice(1, None)), np.zeros(1, dtype=np.intp)
    for factor in graph.factors:
        lines = {len(numbers) - 1: of_steps.lines, len(numbers): table.lines + 1}
        placed = factor.keys[0].kind == "x"
        at = lines[len(factor)] if placed else np.repeat(nowhere, len(factor))
        report.sources.append(Source(table.path if placed else str(folder), at))
    return graph, values, report.scans, report


def _read_folder(folder: str | Path) -> tuple[dict[str, Table], Settings, ScanReport]:
    """The tables by name, the settings, and a report that counts rows and names what was not read."""
    names = names_in(folder)
    for name in NEEDED:
        if file_of(folder, name) is None:
            message = f"has no {name}.csv; a scan mission is keyframes.csv and scans.csv"
            raise GraphFileError(f"{message}; it has {some(names, 12)}", str(folder))
    tables: dict[str, Table] = {}
    for name, columns in COLUMNS.items():
        if (file := file_of(folder, name)) is not None:
            if f"{name}.csv" in names and f"{name}.csv.gz" in names:
                raise GraphFileError(f"there is {name}.csv.gz beside it; remove one of them", str(file))
            tables[name] = Table(file, columns, OPTIONAL.get(name, ()), needed=name in NEEDED)
    path = Path(folder, SETTINGS)
    settings = read_settings(path) if path.exists() else Settings()
    report = ScanReport(str(folder), "scan mission", "2-D", "log", vertices_given=False, reason="a folder")
    report.tags = {f"{name}.csv": len(table) for name, table in tables.items()}
    note_comments(report, sum(table.comments for table in tables.values()))
    _note_others(report, names, {Path(table.path).name for table in tables.values()})
    return tables, settings, report


def _note_others(report: ScanReport, names: list[str], read: set[str]) -> None:
    """Name the files that were not read; the keyframes hold the odometry."""
    others = [name for name in names if name not in (*read, *NOT_MISSED) and not name.upper().startswith("README")]
    reckoned = [name for name in others if name in ("odometry.csv", "odometry.csv.gz")]
    if reckoned:
        report.notes.append(f"not needed: {reckoned[0]}; the keyframes hold dead reckoning")
    note_others(report, "scan mission", [name for name in others if name not in reckoned], [*COLUMNS, SETTINGS])


def _keyframes(table: Table) -> tuple[Numbers, Array, Array]:
    """Numbers (n,), times (n,) and reckoned poses (n, 3) of the keyframes."""
    numbers, times = table.unique("keyframe", "keyframe"), table.rising("time")
    falls, rise = np.append(False, np.diff(numbers) < 0), "expected numbers that rise, sort the rows"
    table.refuse_rows(falls, lambda k: f"keyframe {numbers[k]} after {numbers[k - 1]}; {rise}")
    if len(numbers) < 2:
        raise table.at(0, "is the only keyframe; expected two or more")
    table.within(1e9, "meters, within 1e9", "x", "y")
    table.within(TURNS, "radians, -2 pi to 2 pi", "yaw")
    return numbers, times, table.floats("x", "y", "yaw")


def _scans(table: Table, numbers: Numbers, settings: Settings) -> tuple[Scans, Array | None]:
    """The points, and their intensities (n,) in the same order."""
    problem = f"no such keyframe in keyframes.csv, which has {len(numbers)} from {numbers[0]} to {numbers[-1]}"
    rows = np.searchsorted(numbers, table.known("keyframe", numbers, problem))
    r = table.positive("range")[:, 0]
    table.within(1e3, "meters, within 1000 (in millimeters?)", "range")
    azimuth = settings.side * table.within(TURNS, "radians, -2 pi to 2 pi", "azimuth")[:, 0]
    points = r[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    intensity = table.measured("intensity")[:, 0] if table.has("intensity") else None
    order = np.argsort(rows, kind="stable")
    scans = Scans(points[order], rows[order], len(numbers), settings.mount)
    return scans, None if intensity is None else intensity[order]


def _truth(table: Table, times: Array, report: ScanReport) -> Truth:
    """True poses at the keyframes: on the line between two rows."""
    t, p = table.rising("time"), table.within(1e9, "meters, within 1e9", "x", "y")
    yaw = table.within(TURNS, "radians, -2 pi to 2 pi", "yaw")[:, 0] if table.has("yaw") else np.zeros(len(t))
    inside = (times >= t[0]) & (times <= t[-1])
    if (count := int(inside.sum())) < 2:
        raise table.at(
            0,
            f"the truth is of {float(t[0])!r} to {float(t[-1])!r} s and the keyframes of {float(times[0])!r} to "
            f"{float(times[-1])!r} s: {count} of these within, expected 2 or more",
        )
    if outside := len(times) - count:
        report.notes.append(f"errors are of {count} keyframes, not of {outside} before or after the truth")
    columns = [*p.T, np.unwrap(yaw)]
    return Truth(np.flatnonzero(inside), np.column_stack([np.interp(times[inside], t, c) for c in columns]))


@dataclass(frozen=True)
class Settings:
    """How a mission was sailed.

    Attributes
    ----------
    side : 1 where azimuths are positive to the left, -1 to the right.
    mount : pose of the sonar on the vehicle: x ahead and y to the left, m, and yaw, rad.
    drift : how wrong dead reckoning is.
    """

    side: float = 1.0
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift: Drift = field(default_factory=Drift)


def read_settings(path: str | Path) -> Settings:
    """The settings in a file.

    Raises
    ------
    GraphFileError
        No TOML, an unknown section or key, a value that cannot be: with file and line.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "mission.toml")
    ...     _ = file.write_text('[sonar]\\nazimuth = "right"\\nx_m = 0.4\\n')
    ...     settings = read_settings(file)
    >>> settings.side, settings.mount
    (-1.0, (0.4, 0.0, 0.0))
    """
    file = TomlFile.read(path)
    _refuse_unknown(file)
    sonar, drift = file.tree.get("sonar", {}), file.tree.get("drift", {})
    side = sonar.get("azimuth", "left")
    if not isinstance(side, str) or side not in SIDES:
        near = did_you_mean(side, SIDES) if isinstance(side, str) else ""
        raise file.error(
            "sonar", "azimuth", f"azimuth is {side!r}; expected the positive side, 'left' or 'right'{near}"
        )
    for name in MOUNT:
        limit, unit = (6.2832, "rad") if name == "yaw_rad" else (1e3, "m")
        if not is_number(value := sonar.get(name, 0.0)) or not abs(value) <= limit:
            raise file.error("sonar", name, f"{name} is {value!r}; expected a number, {unit}, within {limit:g}")
    for name, value in drift.items():
        if name == "heading" and value is False:
            continue
        if not is_number(value) or not 1e-6 <= value <= 1e3:
            none = ", or false: no compass" if name == "heading" else ""
            allowed = f"a number from 1e-06 to 1000{none}"
            raise file.error("drift", name, f"{name} is {value!r:.40}; expected {allowed}")
    x, y, yaw = (float(sonar.get(name, 0.0)) for name in MOUNT)
    given: dict[str, Any] = {name: None if value is False else float(value) for name, value in drift.items()}
    return Settings(SIDES[side], (x, y, yaw), Drift(**given))


def _refuse_unknown(file: TomlFile) -> None:
    """Refuse sections and keys that a mission does not have."""
    for section, content in file.tree.items():
        known = " and ".join(f"[{name}]" for name in SECTIONS)
        if section not in SECTIONS:
            raise file.error(
                section, "", f"unknown section {section!r}; expected {known}{did_you_mean(section, SECTIONS)}"
            )
        if not isinstance(content, dict):
            raise file.error(section, "", f"{section} is {content!r}; expected a section, [{section}]")
        for key in content:
            if key not in SECTIONS[section]:
                near = did_you_mean(key, SECTIONS[section])
                message = f"[{section}] has no {key!r}; expected {', '.join(SECTIONS[section])}{near}"
                raise file.error(section, key, message)
