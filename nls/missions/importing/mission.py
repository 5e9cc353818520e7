"""Logs and a mapping as the files of a mission folder: one zero of time, one origin, and a README that says both.

Each log is read once. A section is made from the log it names, or from the only one that has its columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphFileError, OptionError
from models.geodesy import LocalPlane
from models.listing import several
from models.options import did_you_mean
from models.visible import visible
from nls.io.files import write_folder
from nls.missions.folder.columns import COLUMNS, needed
from nls.missions.folder.table import csv_text
from nls.missions.importing.bags import Bag, is_bag, refuse_no_log
from nls.missions.importing.dates import NANOSECONDS, iso, parse_zero
from nls.missions.importing.mapping import Mapping, Section
from nls.missions.importing.quantities import DAY, WEEK
from nls.missions.importing.tables import TIMES, WHOLE, Rows, rows_of
from nls.missions.importing.text_log import Log, TextLog
from nls.stages import announce

READING = ("separator", "decimal", "header", "skip", "join")  # options of a section that say how its log is read


@dataclass(frozen=True)
class Imported:
    """The files of a mission as they are to be written.

    Attributes
    ----------
    files : content by name, README.txt among them.
    rows : how many by table.
    notes : what was assumed, converted and left out.
    """

    files: dict[str, bytes] = field(repr=False)
    rows: dict[str, int]
    notes: list[str] = field(default_factory=list)


def import_logs(logs: Sequence[str | Path], mapping: Mapping) -> Imported:
    """The mission files of logs.

    Parameters
    ----------
    logs : text files and bags.
    mapping : which of their columns are which of the mission's.

    Raises
    ------
    GraphFileError
        A column, cell, unit, time or place that cannot be; says the line of the log or of the mapping.
    OptionError
        Two logs of one name.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = Path(folder, "log.csv")
    ...     _ = log.write_text("t [ms];depth [cm]\\n0;250\\n500;260\\n")
    ...     imported = import_logs([log], Mapping('depth = { time_s = "t [ms]", z_m = "depth [cm]" }', "mapping.toml"))
    >>> print(imported.files["depth.csv"].decode())
    time_s,z_m
    0.0,2.5
    0.5,2.6
    """
    refuse_no_log(logs)
    sources = Logs(logs)
    parts = [rows_of(section, sources.of(section)) for section in mapping.sections]
    if logs and not any(section.used for section in mapping.sections):
        names = ", ".join(sources.paths)
        raise GraphFileError(f'uses no column of {names}; write the name of one, such as time_s = "Time"', mapping.path)
    notes = [*sources.notes, *dict.fromkeys(note for log in sources.used.values() for note in log.notes)]
    notes += dict.fromkeys(note for part in parts for note in part.notes)
    zero = _zero(mapping, parts, notes)
    origin = _origin(parts, notes)
    files, rows = {}, {}
    for table in COLUMNS:
        if table == "origin":
            if origin is not None:
                files["origin.csv"] = csv_text(COLUMNS["origin"], [[origin.lat, origin.lon]])
                rows["origin"] = 1
        elif several_parts := [part for part in parts if part.section.table == table]:
            files[f"{table}.csv"], rows[table] = _text(several_parts, zero, origin)
    if missing := _missing(set(rows)):
        notes.append(missing)
    files["README.txt"] = _readme(sources, mapping, rows, notes)
    return Imported(files, rows, notes)


def write_imported(folder: str | Path, imported: Imported, read: Sequence[str | Path]) -> list[str]:
    """Write the files of a mission into a folder; earlier ones of the same names are replaced.

    Parameters
    ----------
    folder : where.
    imported : the files.
    read : the logs and the mapping, which are never replaced.

    Raises
    ------
    OptionError
        A file that would replace one that was read.
    GraphFileError
        The folder holds files of another mission, or cannot be written.
    """
    from nls.missions.folder.write import refuse_mixed  # imported here: it loads all of the graph

    inputs = {Path(path).resolve() for path in read}
    for name in imported.files:
        if Path(folder, name).resolve() in inputs:
            raise OptionError("output folder", str(folder), f"another folder: {name} there is a log that is read")
    refuse_mixed(folder, imported.files)
    return write_folder(folder, imported.files)


def _zero(mapping: Mapping, parts: Sequence[Rows], notes: list[str]) -> int:
    """The zero of times since 1970, ns: as the mapping says, else the whole second before the first one."""
    since = {part.section.table: s for part in parts for s in part.times.values() if s.since_1970}
    own = [(part.section, s) for part in parts for s in part.times.values() if not s.since_1970]
    known = [int(f(s.ns[s.present])) for s in since.values() for f in (np.min, np.max)] or [0]
    first, last = min(known), max(known)
    if since and own:
        section, stamp = own[0]
        days, of_day = first // DAY, stamp.ns.max() <= DAY
        midnight = (days if of_day else days - (days + 4) % 7) * DAY  # of the day, or of the Sunday before
        fits = stamp.ns.max() <= WEEK and midnight + stamp.ns[0] <= last and midnight + stamp.ns[-1] >= first
        write = "time_s = { column = ..., offset = SECONDS }"
        if fits:
            write = f'`date = "{iso(midnight)[:10]}"`, as they are of the {"day" if of_day else "week of GPS"},'
        rest = f"those of [{next(iter(since))}] are since 1970; write {write} in [{section.table}] of the mapping"
        raise section.error("time_s", f"the times of [{section.table}] have a zero of their own, {rest}")
    if mapping.time_zero is not None:
        zero = parse_zero(mapping.time_zero)
        if zero is None:
            expected = 'expected a time of ISO 8601 such as "2020-05-01T12:00:00Z", or seconds since 1970'
            raise mapping.error("", "time_zero", f"{mapping.time_zero!r} is not possible; {expected}")
        if not since:
            raise mapping.error("", "time_zero", "no time of the logs is since 1970; leave time_zero out")
    elif since:
        zero = first // NANOSECONDS * NANOSECONDS
    else:
        return 0
    seconds = f"{zero / NANOSECONDS:.9g}" if zero % NANOSECONDS else f"{zero // NANOSECONDS}"
    notes.append(f"time_zero {iso(zero)}: {seconds} s since 1970 are subtracted from all times")
    return zero


def _origin(parts: Sequence[Rows], notes: list[str]) -> LocalPlane | None:
    """The plane at [origin], else at the first latitude and longitude."""
    candidates = [part for part in parts if {"lat_deg", "lon_deg"} <= part.numbers.keys()]
    for part in sorted(candidates, key=lambda part: part.section.table != "origin"):
        places = np.column_stack([part.numbers[name] for name in ("lat_deg", "lon_deg")])
        lat, lon = places[np.argmax(places.any(axis=1))].tolist()  # a receiver without a fix writes 0, 0
        try:
            plane = LocalPlane(lat, lon)
        except OptionError as error:
            raise part.section.error("lat_deg", str(error)) from error
        if part.section.table != "origin" or part.section.used:
            notes.append(f"the origin x = y = 0 is the first place of [{part.section.table}]: {lat!r}, {lon!r} deg")
        return plane
    for part in parts:
        if {"lat_deg", "lon_deg"} & part.numbers.keys():
            raise part.section.error("lat_deg", "lat_deg and lon_deg belong together; one is missing")
    return None


def _text(parts: Sequence[Rows], zero: int, origin: LocalPlane | None) -> tuple[bytes, int]:
    """A table and its number of rows, of one or more sections."""
    table = parts[0].section.table
    columns = [_columns(part, zero, origin) for part in parts]
    for part, own in zip(parts, columns, strict=True):
        if own.keys() != columns[0].keys():
            other = sorted(own.keys() ^ columns[0].keys())[0]
            raise part.section.error("", f"one section [[{table}]] has {other} and another has not; give it in all")
    names = [name for name in COLUMNS[table] if name in columns[0]]
    merged = {name: np.concatenate([np.asarray(own[name]) for own in columns]) for name in names}
    count = len(merged[names[0]])
    order = np.arange(count)
    if len(parts) > 1 and "time_s" in merged:
        order = np.argsort(merged["time_s"], kind="stable")
    _refuse_whole(parts[0].section, merged)
    announce(f"{table}.csv: {count:,} rows")
    for name in names:
        if name in (*WHOLE, "valid"):
            merged[name] = merged[name].astype(np.int64)
    return csv_text(names, *(_cells(merged[name][order]) for name in names)), count


def _columns(part: Rows, zero: int, origin: LocalPlane | None) -> dict[str, npt.ArrayLike]:
    """The columns of a section with times from the zero of the mission and places on its plane."""
    numbers: dict[str, npt.ArrayLike] = {**part.numbers, **part.words}
    numbers |= {name: stamp.relative(zero) for name, stamp in part.times.items()}
    if "lat_deg" in part.numbers and "lat_deg" not in COLUMNS[part.section.table]:
        assert origin is not None
        try:
            place = origin.local(numbers.pop("lat_deg"), numbers.pop("lon_deg"))
        except OptionError as error:
            raise part.section.error("lat_deg", str(error)) from error
        numbers |= {"x_m": place[:, 0], "y_m": place[:, 1]}
    return numbers


def _refuse_whole(section: Section, merged: dict[str, Array]) -> None:
    """Refuse a number of a pose or a landmark that is not whole, and times that are constants."""
    for name in WHOLE:
        if name in merged and (bad := (merged[name] != np.rint(merged[name])) | (np.abs(merged[name]) > 2**53)).any():
            k = int(np.argmax(bad))
            raise section.error(name, f"{name} is {float(merged[name][k])!r}; expected whole numbers, up to 2^53")
    timed = [section.cells[name] for name in TIMES if name in section.cells]
    if section.used and any(not cell.columns and cell.row is None for cell in timed):
        raise section.error("time_s", "time_s is a constant, and times rise; name the column of the log")


def _cells(column: Array) -> npt.ArrayLike:
    """Cells of a CSV file; words with a comma or a quotation mark stand in quotation marks."""
    if column.dtype.kind != "U":
        return column
    return ['"' + word.replace('"', '""') + '"' if "," in word or '"' in word else word for word in column.tolist()]


def _missing(tables: set[str]) -> str:
    """The note on what a mission still needs."""
    of_sonar = ("contacts", "sonar") if tables & {"contacts", "sonar"} else ()
    absent = [f"{name}.csv" for name in (*needed(tables), *of_sonar) if name not in tables]
    if not absent:
        return ""
    walk = "write `sigma_walk_m_sqrt_s = 0.5` in [motion] of the mapping: meters that the vehicle may go in a second"
    walk = f"; without a DVL {walk}" if "dvl.csv" in absent else ""
    needs = f"nls solve needs {', '.join(absent)} besides"
    return f"{needs}: give the sections, or the files (nls new writes templates){walk}"


def _readme(sources: Logs, mapping: Mapping, rows: dict[str, int], notes: Sequence[str]) -> bytes:
    """The contents of the folder, for people."""
    lines = [
        "A mission, made by nls import.",
        "Axes of the world: x north, y east, z down. Of the body: x ahead, y to starboard, z down. SI units.",
        "",
        *(f"log      {path}" for path in sources.paths.values()),
        f"mapping  {mapping.path}",
        *(f"table    {name}.csv: {several(count, 'row')}" for name, count in rows.items()),
        *(f"note     {note}" for note in notes),
        "",
        "The mapping:",
        "",
        mapping.text.rstrip("\n"),
    ]
    return (visible("\n".join(lines)) + "\n").encode()


class Logs:
    """The logs that were given.

    Parameters
    ----------
    paths : of text files and bags.

    Raises
    ------
    OptionError
        Two of one name.
    """

    def __init__(self, paths: Sequence[str | Path]) -> None:
        self.paths = {Path(path).name: str(path) for path in paths}
        if len(self.paths) < len(paths):
            raise OptionError("LOG", [str(path) for path in paths], "files of different names, which a mapping tells")
        self.used: dict[Any, Log] = {}  # that were read, by how they were
        self._bags: dict[str, Bag] = {}
        self.notes: list[str] = []

    def bag(self, name: str) -> Bag:
        """A bag, opened once."""
        if name not in self._bags:
            self._bags[name] = Bag(self.paths[name])
        return self._bags[name]

    def of(self, section: Section) -> Log:
        """The log of a section: the one it names, else the only one that has its columns; of constants a row of none.

        Raises
        ------
        GraphFileError
            No such log, several that have these columns; a log that cannot be read.
        """
        if not section.used:
            for option in ("file", "topic", "where", "rows"):
                given = section.options.get(option)
                if given is not None and given != section.mapping.tree.get(option):
                    log = given if option == "file" else "a log"
                    cure = f"name one of its columns, or leave {option} out"
                    raise section.error(option, f"[{section.table}] uses no column of {log}; {cure}")
            return Log("", "", [], [], np.zeros(1, dtype=np.intp))
        if (named := section.options.get("file")) is not None:
            if (name := Path(named).name) not in self.paths:
                rest = f"{did_you_mean(name, self.paths) or ';'} given: {', '.join(self.paths.values())}"
                raise section.error("file", f"{named!r} is not among the logs that are given{rest}")
            return self._log(section, name)
        if len(self.paths) == 1:
            return self._log(section, next(iter(self.paths)))
        if "topic" in section.options:
            bags = [name for name, path in self.paths.items() if is_bag(path)]
            candidates = [name for name in bags if section.options["topic"] in self.bag(name).topics] or bags
        else:
            candidates = [name for name, path in self.paths.items() if not is_bag(path)]
        logs = {name: self._log(section, name) for name in candidates}
        fitting = [name for name, log in logs.items() if set(section.used) <= set(log.names)]
        if len(fitting) == 1:
            self.notes.append(f"[{section.table}] is of {fitting[0]}, the only log with its columns")
            return logs[fitting[0]]
        if fitting:
            write = " or ".join(f'file = "{name}"' for name in fitting)
            raise section.error("", f"[{section.table}] may be of several logs; write {write}")
        if not logs:
            raise section.error("", f"[{section.table}] is of no log that is given; write file or topic")
        # the nearest, whose missing column is refused with the closest one
        return max(logs.values(), key=lambda log: sum(name in log.names for name in section.used))

    def _log(self, section: Section, name: str) -> Log:
        """One log, read as the section says."""
        path = self.paths[name]
        if is_bag(path):
            topic = section.options.get("topic")
            bag = self.bag(name)
            if topic is None:
                raise section.error("", f"{name} is a bag; write topic = one of {', '.join(map(repr, bag.topics))}")
            if topic not in bag.topics:
                rest = f"{did_you_mean(topic, bag.topics) or ';'} it has {', '.join(map(repr, bag.topics))}"
                raise section.error("topic", f"{name} has no topic {topic!r}{rest}")
            if (name, topic) not in self.used:
                self.used[name, topic] = bag.log(topic)
            return self.used[name, topic]
        if "topic" in section.options:
            raise section.error("topic", f"{name} is a text file and has no topics; leave topic out")
        how = {option: section.options[option] for option in READING if option in section.options}
        where = section.options.get("where")
        chosen = None if where is None else (str(where["column"]), str(where["equals"]))
        key = (name, *how.items(), chosen)
        if key not in self.used:
            try:
                self.used[key] = TextLog(path, where=chosen, **how)
            except GraphFileError as error:
                option = next((option for option in ("where", "join", "skip") if option in section.options), "")
                if not option or error.line is not None:
                    raise
                raise section.error(option, f"{error}; correct {option}") from error
        return self.used[key]
