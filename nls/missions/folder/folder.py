"""A mission folder: its files, each read as the table it must be, missing and unread files, and its report."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Self

from factors.base import Factor
from models.advice import Advice
from models.algebra import Array, Index, Mask
from models.errors import GraphFileError
from models.geodesy import LocalPlane
from models.listing import some
from nls.io.files import unreadable
from nls.io.formats import suffixes
from nls.io.report import LoadReport
from nls.io.unused_lines import note_comments
from nls.missions.folder.columns import ALONE, BESIDE, COLUMNS, LOG, TRACK, needed, optional
from nls.missions.folder.table import Table
from nls.values import Values

if TYPE_CHECKING:
    from factors import RangeAzimuth
    from models.sensors import ImagingSonar
    from nls.missions.checks.findings import Explained, Implausible, TableError


@dataclass(frozen=True)
class Unnamed:
    """Contacts of a mission that names no landmarks; they are in no factor until `nls.missions.associated` finds them.

    Attributes
    ----------
    contacts : n of them, within the track; each has its own number for a target.
    table, rows : contacts.csv, and the row (n,) of each.
    elevation : what is done about the elevation once their landmarks are known, see `factors.sonar_factors`.
    """

    contacts: RangeAzimuth
    table: Table
    rows: Index
    elevation: str

    def __len__(self) -> int:
        return len(self.contacts)

    def note(self, path: str) -> str:
        """The remark of the report of a mission folder on contacts that are not in its graph."""
        return (
            f"contacts.csv names no landmarks: none of its {len(self):,} contacts is in the graph, nor in a file or "
            f"picture of it. nls solve {shlex.quote(path)} --write-graph FILE finds their landmarks and writes the "
            "graph with them; in Python nls.missions.associated(graph, values, report)"
        )


@dataclass
class MissionReport(LoadReport):
    """The report of a mission folder; `vertex_times` has the times of its poses where poses.csv gives them.

    Attributes
    ----------
    truth : the true poses ``x`` and landmarks ``l``, those of the files; no stacks where there is no truth.
    sonar : the sonar its contacts were seen with; None without contacts.
    offset : (7,) its mounting, the pose of the sonar on the vehicle, SE3.
    unmeasured : components of a pose, such as ``yaw``, that nothing measures: held at 0, their cells are empty.
    compass : whether a sensor measures the heading in the world.
    elsewhere : dive_closures.csv, whose rows need the poses of other dives; None without it.
    world : the files that say where in the world the track is, instead of an anchor; empty where there is an anchor.
    soundings : (n, 2) times and heights of the vehicle over the bottom, s and m; None where its log has none.
    findings : what is implausible in the tables, each also a warning.
    explained : what explains chi2 where it was implausible; None where it was not asked.
    errors : of whole tables at the optimum, as `nls.missions.checks.table_errors` has them.
    plane : where x = y = 0 is on the Earth, with x north and y east; None where no file says it.
    unnamed : the contacts that name no landmark, and so are in no factor; None where there are none.
    dive_of : the name of the dive that each factor is of; empty for one mission.
    calibrations : value and standard deviation of the calibrations that are variables by name, before the measurements.
    """

    truth: Values = field(default_factory=Values)
    sonar: ImagingSonar | None = None
    offset: Array | None = field(default=None, compare=False)
    unmeasured: tuple[str, ...] = ()
    compass: bool = False
    elsewhere: Table | None = field(default=None, compare=False, repr=False)
    world: list[str] = field(default_factory=list)
    soundings: Array | None = field(default=None, compare=False)
    plane: LocalPlane | None = None
    calibrations: dict[str, tuple[float, float]] = field(default_factory=dict)
    findings: list[Implausible] = field(default_factory=list)
    explained: Explained | None = None
    errors: list[TableError] = field(default_factory=list)
    unnamed: Unnamed | None = field(default=None, compare=False, repr=False)
    dive_of: list[str] = field(default_factory=list, repr=False)

    @property
    def counts(self) -> dict[str, int]:
        """The contacts that are not in the graph, where there are some."""
        return {} if self.unnamed is None else {"contacts_without_names": len(self.unnamed)}

    @property
    def tables(self) -> list[str]:
        """The file that each factor is from, such as ``fixes.csv``; of several dives with the name of the dive."""
        files = [Path(source.path).name for source in self.sources]
        return [f"{dive}/{file}" for dive, file in zip(self.dive_of, files, strict=True)] if self.dive_of else files

    def of_parts(self, factors: Sequence[Factor], parts: Sequence[tuple[int, Mask, Factor]]) -> Self:
        """The report of a graph of parts of these factors, as for `LoadReport`; with the dives that they are of."""
        dives = [self.dive_of[k] for k, _, _ in parts] if self.dive_of else []
        return replace(super().of_parts(factors, parts), dive_of=dives)

    @property
    def anchored(self) -> bool:
        """Whether a file places the mission in the world."""
        return bool(self.world) or "anchor.csv" in self.tags


NOT_MISSED = ("README.txt", "mapping.toml", "templates", "graph.npz", "truth.npz")  # for people; the graph in one file
EXPECTED = (
    "a mission is odometry.csv and zpr.csv, or dvl.csv, ahrs.csv, depth.csv (or pressure.csv) and noise.csv, or "
    "path.csv, or motion.csv (and ahrs.csv, depth.csv, and then noise.csv), with contacts.csv and sonar.csv, both or "
    "none of these two; a scan mission is "
    "keyframes.csv and scans.csv"
)


def read_tables(folder: str | Path) -> tuple[dict[str, Table], MissionReport]:
    """The tables of a mission folder by name, and a report that counts their rows and names what was not read.

    Raises
    ------
    GraphFileError
        No mission, or not all of one; a file that is not the table its name says.
    """
    path, names = Path(folder), names_in(folder)
    files: dict[str, Path] = {}
    other_files = []
    for name in names:
        table = name.removesuffix(".gz").removesuffix(".csv")
        if name not in (f"{table}.csv", f"{table}.csv.gz") or table not in COLUMNS:
            other_files.append(name)
        elif table in files:
            raise GraphFileError(f"there is {files[table].name} beside it; remove one of them", str(path / name))
        else:
            files[table] = _regular(path / name)
    _refuse_parts(str(folder), set(files), other_files)

    tables = {name: Table(file, COLUMNS[name], optional(name, files)) for name, file in files.items()}
    report = report_of(folder, tables)
    note_comments(report, sum(table.comments for table in tables.values()))
    note_others(report, "mission", [name for name in other_files if name not in NOT_MISSED], list(COLUMNS))
    return tables, report


def note_others(report: LoadReport, noun: str, others: list[str], expected: list[str]) -> None:
    """Name the files that were not read: CSV files in a warning, other files of data in a note."""
    if tabular := [name for name in others if ".csv" in name.lower()]:
        report.warn(f"no file of a {noun}, not read: {_listed(tabular)}; expected names: {_listed(expected)}")
    if unread := [name for name in others if name not in tabular]:
        report.notes.append(f"not read: {_listed(unread)}")


def names_in(folder: str | Path) -> list[str]:
    """The names of the files in a folder, sorted.

    Raises
    ------
    GraphFileError
        It cannot be read.
    """
    try:
        return sorted(os.listdir(folder))
    except OSError as error:
        raise unreadable(folder, error) from error


def report_of(folder: str | Path, tables: dict[str, Table]) -> MissionReport:
    """A report that counts the rows of tables."""
    report = MissionReport(str(folder), "mission", "3-D", "log", vertices_given=False, reason="a folder")
    report.tags = {f"{name}.csv": len(table) for name, table in tables.items()}
    return report


def _regular(file: Path) -> Path:
    """Refuse a pipe or a device, which would be waited for; what a folder or a lost link is, reading says."""
    if file.exists() and not (file.is_file() or file.is_dir()):
        raise GraphFileError("is a pipe or a device; expected a file", str(file))
    return file


def _refuse_parts(folder: str, files: set[str], other_files: list[str]) -> None:
    """Refuse a folder that is no mission, half of one or two in one."""
    if not files & {*TRACK, *LOG, "pressure", *ALONE}:
        if {"trajectory.csv", "map.csv"} & {*other_files}:
            parent = Path(os.path.relpath(Path(folder).absolute().parent))
            is_mission = any((parent / f"{name}.csv").exists() for name in (*TRACK, *LOG, *ALONE))
            mission = shlex.quote(str(parent)) if is_mission else "the folder of the mission"
            raise GraphFileError(f"is the solution of a mission, not a mission; give {mission} instead", folder)
        contents = f"it has {_listed(sorted(files) + other_files)}" if files or other_files else "it is empty"
        endings = {name: Path(name.removesuffix(".gz")).suffix for name in other_files}
        graphs = [name for name, suffix in endings.items() if suffix in suffixes() and suffix != ".csv"]
        advice = [Advice("read file", (os.path.join(folder, name),)) for name in graphs[:1]]
        logs = [name for name, suffix in endings.items() if suffix in (".csv", ".txt", ".bag", ".mcap")]
        if logs and not advice:
            advice = [Advice("import", (shlex.quote(os.path.join(folder, logs[0])),)), Advice("template")]
        raise GraphFileError(f"is a folder, but no mission: {EXPECTED}; {contents}", folder, advice=advice)
    if (track := files & set(TRACK)) and (log := files & {*LOG, *BESIDE}):
        compass = "; the headings of a compass go into zpr.csv, columns yaw_rad and sigma_yaw_rad" * ("ahrs" in log)
        cure = f"keep either the integrated odometry or the raw log{compass}"
        raise GraphFileError(f"has {sorted(track)[0]}.csv and {sorted(log)[0]}.csv, the motion twice; {cure}", folder)
    if {"depth", "pressure"} <= files:
        raise GraphFileError("has depth.csv and pressure.csv, the depth twice; remove one of them", folder)
    for name, beside in ALONE.items():
        if name in files and (other := files & ({*TRACK, *LOG, *BESIDE, *ALONE, "poses"} - {name, *beside})):
            cure = "remove one of them"
            raise GraphFileError(f"has {name}.csv and {sorted(other)[0]}.csv, the motion twice; {cure}", folder)
    if (missing := [name for name in needed(files) if name not in files]) and "motion" not in files:
        message = f"has no {missing[0]}.csv; {EXPECTED}{_near_miss(missing[0], other_files)}"
        raise GraphFileError(message, folder, advice=[Advice("template")])
    for present, name, says in (
        ("contacts", "sonar", "what sonar saw them, and from where"),
        ("sonar", "contacts", "what the sonar saw; leave sonar.csv out where it saw nothing"),
    ):
        if present in files and name not in files:
            rest = f"which says {says}{_near_miss(name, other_files)}"
            raise GraphFileError(f"has {present}.csv and no {name}.csv, {rest}", folder)


def _near_miss(name: str, other_files: list[str]) -> str:
    """Names a file that is not read and may be meant for the one that is missing."""
    near = {file.lower().removesuffix(".gz").removesuffix(".csv").strip(): file for file in other_files}
    close = get_close_matches(name, near, n=1, cutoff=0.8)
    return f"; is it {_listed([near[close[0]]])}? names are written as here" if close else ""


def _listed(names: list[str]) -> str:
    return some([repr(name)[1:-1] for name in names], 12)
