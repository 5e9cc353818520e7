"""mapping.toml: one section for each table of the mission, each of its columns a column of the log or a constant.

    time_s = "Time [s]"                                      above all sections: for every table that has this column
    dvl.velocity = ["DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]"]
    [depth]
    file = "pressure.csv"                                    where several logs are given and have these columns
    z_m = { column = "Altitude [m]", up = true }             also unit, sign, scale, offset, missing
    [noise]
    sigma_v_m_s = 0.02

`velocity`, `attitude` and `position` stand for three columns each, `sigma_attitude` and so on for their sigmas;
`quaternion` for an attitude as x, y, z, w, `rotation` for one as nine numbers, row by row.
"""

from __future__ import annotations

import re
from collections.abc import Mapping as Mappings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from models.errors import GraphFileError, OptionError
from models.options import did_you_mean, is_number
from nls.missions.folder.columns import ANGLES, COLUMNS, GEODETIC, PLACE, VELOCITY, suffixed
from nls.missions.folder.toml_file import TomlFile
from nls.missions.importing.cell import Cell, none_words, read_cell, stand_for_none
from nls.missions.importing.dates import check_format, is_date
from nls.missions.importing.frames import FRAMES, axes
from nls.missions.importing.text_log import SEPARATORS, Missing

GROUPS: dict[str, tuple[str, ...]] = {"velocity": VELOCITY, "attitude": ANGLES, "position": PLACE}
GROUPS |= {f"sigma_{name}": suffixed(columns) for name, columns in GROUPS.items()}
ROTATIONS = {"quaternion": (4, "x, y, z, w"), "rotation": (9, "a matrix row by row")}
OPTIONS = {  # of a section, with what they may be
    "file": "the name of a log that is given",
    "topic": "the name of a topic of a bag, such as '/dvl'",
    "frame": f"one of {', '.join(FRAMES)}, or a pair such as 'ENU/FRD'",
    "sort": "true: rows are sorted by time",
    "duplicates": "'first': of rows of one time the first counts",
    "separator": "'comma', 'semicolon', 'tab', 'blank', or a sign",
    "decimal": "'.' or ','",
    "header": "true or false",
    "skip": "a whole number of lines",
    "where": "{ column = ..., equals = ... }",
    "join": "a whole number of lines that are one row",
    "rows": "[first], or [first, last]: rows from one to before another, counted from 0; -1 is the last",
    "missing": "numbers and words that mean a missing value: one, a list, or a table of them by column",
    "missing_together": "a table of numbers by column: in rows where all of them match, all are missing",
    "date": "the day of the first row, from whose midnight its time counts, such as '2022-08-14'",
    "time_format": "how times are written, such as '%m/%d/%Y %H:%M:%S'",
}
TOGETHER = "missing_together"
ABOVE_ALL = ("time_s", "time_zero", *(name for name in OPTIONS if name not in ("topic", "rows", TOGETHER)))


@dataclass
class Section:
    """A section of the mapping, which makes rows of one table.

    Attributes
    ----------
    table : its name in the mission, without ``.csv``.
    cells : by column.
    options : see `OPTIONS`.
    rotation : ``quaternion`` or ``rotation`` and its columns or numbers, where the attitude is one.
    groups : the name of the group that a column stands in.
    missing : numbers and words that stand for none, by column, group or rotation.
    together : columns of the log, or constants, and what they all are in a row that has none of them.
    mapping : that it stands in, for messages.
    part : which of the sections of its table it is.
    """

    table: str
    cells: dict[str, Cell]
    options: dict[str, Any]
    rotation: tuple[str, tuple[Any, ...]] | None
    groups: dict[str, str]
    missing: dict[str, Missing]
    together: list[tuple[Any, Missing]]
    mapping: Mapping = field(repr=False)
    part: int = 0

    def error(self, key: str, message: str) -> GraphFileError:
        """An error at the line of a key of this section."""
        return self.mapping.error(self.table, self.groups.get(key, key), message, self.part)

    @property
    def used(self) -> list[str]:
        """Columns of the log that it needs."""
        names = [name for cell in self.cells.values() for name in cell.columns]
        return names + [part for part in (self.rotation[1] if self.rotation else ()) if isinstance(part, str)]


class Mapping(TomlFile):
    """A mapping as it was read.

    Parameters
    ----------
    text : of the file.
    path : for messages.

    Attributes
    ----------
    sections : in the order of the file.
    time_zero : what is time 0 of the mission, as it stands there; None where it is not said.

    Raises
    ------
    GraphFileError
        No TOML, a table or column that no mission has, a value that cannot be; says the line.
    """

    def __init__(self, text: str, path: str) -> None:
        super().__init__(text, path)
        tree = self.tree
        defaults = {name: value for name, value in tree.items() if name in ABOVE_ALL or not _is_section(value)}
        self.time_zero = defaults.pop("time_zero", None)
        for name in defaults:
            if name not in ABOVE_ALL:
                if name in COLUMNS:
                    raise self.error("", name, f"{name} is {defaults[name]!r}; expected a section, [{name}]")
                near = did_you_mean(name, [*ABOVE_ALL, *COLUMNS])
                raise self.error("", name, f"{name!r} is no table of a mission and no option{near}")
        self.sections: list[Section] = []
        for table, content in tree.items():
            if table in defaults or table == "time_zero":
                continue
            if table not in COLUMNS:
                near = did_you_mean(table, COLUMNS)
                rest = f"is no table of a mission{near or ';'} expected {', '.join(COLUMNS)}"
                raise self.error(table, "", f"[{table}] {rest}")
            for k, part in enumerate(content if isinstance(content, list) else [content]):
                self._reading = table, k  # a row that is of a pose is of no time
                columns = COLUMNS[table] if "i" not in part or table == "poses" else ()
                fitting = {name: value for name, value in defaults.items() if name in OPTIONS or name in columns}
                self.sections.append(self._section(table, fitting | part))
        if not self.sections:
            raise GraphFileError("has no section; expected one for each table, such as [dvl]", path)

    def _refused(self, key: str, message: str) -> GraphFileError:
        """An error in the section that is being read."""
        table, part = self._reading
        return self.error(table, key, message, part)

    def _section(self, table: str, content: Mappings[str, Any]) -> Section:
        """A section with its groups taken apart."""
        options = {name: value for name, value in content.items() if name in OPTIONS}
        for name, value in options.items():
            self._refuse_option(name, value)
        cells: dict[str, Cell] = {}
        groups: dict[str, str] = {}
        rotation = None
        known = COLUMNS[table]

        def cell(place: str, column: str, value: Any) -> Cell:
            return read_cell(table, column, value, lambda problem: self._refused(place, problem))

        for name, value in content.items():
            columns = tuple(column for column in GROUPS.get(name, ()) if column in known)
            if name in OPTIONS:
                continue
            if name in ROTATIONS and set(ANGLES) <= set(known):
                rotation = name, self._parts(name, value)
            elif columns:
                if not isinstance(value, list) or len(value) != len(columns):
                    raise self._refused(name, f"{name} is {value!r}; expected a list for {', '.join(columns)}")
                cells |= {column: cell(name, column, v) for column, v in zip(columns, value, strict=True)}
                groups |= dict.fromkeys(columns, name)
            elif name in known or (name in GEODETIC and {"x_m", "y_m"} <= set(known)):
                cells[name] = cell(name, name, value)
            else:
                advice = _advice(name, value, known)
                raise self._refused(name, f"{table}.csv has no column {name!r}{advice}; it has {', '.join(known)}")
        places = {column: [column] for column in cells}
        for group, columns in GROUPS.items():
            if (part := [column for column in columns if column in known]) and set(part) <= cells.keys():
                places[group] = part
        turned, numbers = rotation or ("", ())
        keys = [*places, *([turned] if turned else [])]
        missing = self._none("missing", options.get("missing", ()), keys)
        for column, one in cells.items():
            if one.columns and not one.missing:
                key = next((key for key, part in places.items() if column in part and key in missing), "")
                cells[column] = replace(one, missing=missing.get(key, ()))
        together = [
            (part, values)
            for key, values in self._none(TOGETHER, options.get(TOGETHER, {}), keys).items()
            for part in ([cells[column].source for column in places[key]] if key in places else numbers)
        ]
        self._refuse_times(options, any(name.startswith("time_") and one.columns for name, one in cells.items()))
        return Section(table, cells, options, rotation, groups, missing, together, self, self._reading[1])

    def _none(self, option: str, value: Any, keys: Sequence[str]) -> dict[str, Missing]:
        """The words that stand for none, by the keys of a section."""
        if not isinstance(value, dict):
            return dict.fromkeys(keys, none_words(value))
        for key in value:
            if key not in keys:
                near = did_you_mean(key, keys) or ";"
                raise self._refused(option, f"{option}: {key!r} is not mapped here{near} it has {', '.join(keys)}")
        return {key: none_words(part) for key, part in value.items()}

    def _refuse_times(self, options: Mappings[str, Any], timed: bool) -> None:
        """Refuse how times are written where there are none, and what cannot be read."""
        for name in ("date", "time_format"):
            if name in options and not timed and options[name] != self.tree.get(name):
                raise self._refused(name, f"[{self._reading[0]}] has no column of times; leave {name} out")
        if (form := options.get("time_format")) is not None:
            try:
                check_format(form, "date" in options)
            except ValueError as error:
                raise self._refused("time_format", f"time_format = {form!r} {error}") from error

    def _parts(self, name: str, value: Any) -> tuple[Any, ...]:
        """The columns of a quaternion or a matrix; of a field of a message those below it."""
        count, order = ROTATIONS[name]
        if name == "quaternion" and isinstance(value, str):
            return tuple(f"{value}.{axis}" for axis in "xyzw")
        kinds = {isinstance(part, str) for part in value} if isinstance(value, list) else set()
        if len(kinds) != 1 or len(value) != count or not (True in kinds or all(map(is_number, value))):
            expected = f"expected a list of {count} columns, or of {count} numbers: {order}"
            raise self._refused(name, f"{name} is {value!r}; {expected}")
        return tuple(value)

    def _refuse_option(self, name: str, value: Any) -> None:
        """Refuse an option of a section with a value it cannot have."""
        good = {
            "sort": isinstance(value, bool),
            "header": isinstance(value, bool),
            "skip": isinstance(value, int) and not isinstance(value, bool) and value >= 0,
            "duplicates": value == "first",
            "decimal": value in (".", ","),
            "frame": _is_frame(value),
            "separator": isinstance(value, str) and (value in SEPARATORS or (len(value) == 1 and value not in '"\n\r')),
            "join": isinstance(value, int) and value > 1,
            "rows": isinstance(value, list) and [type(part) for part in value] in ([int], [int, int]),
            "missing": all(map(stand_for_none, value.values() if isinstance(value, dict) else [value])),
            "date": is_date(value),
            TOGETHER: isinstance(value, dict) and all(map(stand_for_none, value.values())),
            "where": isinstance(value, dict) and set(value) == {"column", "equals"},
        }.get(name, isinstance(value, str) and bool(value))
        if not good:
            near = did_you_mean(value, FRAMES) if name == "frame" else ""
            raise self._refused(name, f"{name} is {value!r}; expected {OPTIONS[name]}{near}")


def read_mapping(path: str | Path) -> Mapping:
    """The mapping in a file.

    Raises
    ------
    GraphFileError
        It cannot be read, or is no mapping; says the line.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "mapping.toml")
    ...     _ = file.write_text('[depth]\\ntime_s = "t"\\nz_m = { column = "alt", up = true }\\n')
    ...     (section,) = read_mapping(file).sections
    >>> section.table, section.used, section.cells["z_m"].scale
    ('depth', ['t', 'alt'], -1.0)
    """
    return Mapping.read(path)


def _is_frame(value: Any) -> bool:
    """Whether a value is the name of axes."""
    try:
        return isinstance(value, str) and all(part in FRAMES for part in value.split("/")) and bool(axes(value))
    except OptionError:
        return False


def _is_section(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and all(isinstance(part, dict) for part in value))


def _advice(name: str, value: object, known: tuple[str, ...]) -> str:
    """The line to write in the place of a key that is no column; nothing where no column is like it."""
    shown = str(value) if isinstance(value, int | float) else f'"{value if isinstance(value, str) else "..."}"'
    if name == "valid":
        return f"; select rows: where = {{ column = {shown}, equals = true }}"
    near = did_you_mean(name, [*known, *OPTIONS])
    if column := re.search(r"did you mean '(\w+)'", near):
        return f"{near}; write {column[1]} = {shown}"
    return near
