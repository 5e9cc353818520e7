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
from models.options import did_you_mean, is_number, is_whole
from nls.io.importing.examples import example
from nls.io.importing.frames import FRAMES, axes
from nls.io.importing.sigmas import sigma_words, sigmas_out
from nls.io.importing.text_log import SEPARATORS, Missing
from nls.io.importing.units import dimension, known_units, mission_unit
from nls.io.mission.columns import ANGLES, COLUMNS, PLACE, optional, suffixed
from nls.io.toml_file import TomlFile

__all__ = ["VELOCITY", "WHOLE", "Cell", "Mapping", "Section", "read_mapping", "required"]

VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
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
    "missing": "numbers and words that stand for none: one, a list, or a table of them by column",
}
ABOVE_ALL = ("time_s", "time_zero", *(name for name in OPTIONS if name not in ("topic", "rows")))
CELL = ("column", "unit", "sign", "scale", "offset", "missing", "up", "equals", "above", "row")
PLACES_ON_EARTH = ("lat_deg", "lon_deg")
FINITE, WHOLE = 1e300, 2**53  # numbers below them are numbers of 64 bits, and exact whole ones


@dataclass(frozen=True)
class Cell:
    """How one column of a mission table is made.

    Attributes
    ----------
    columns : of the log; two are a date and a time, or a number and its hemisphere; none for a constant.
    constant : a number, a word or True or False.
    unit : of the log, empty where its header says it.
    scale, offset : what a number is multiplied with and what is added then, in the unit of the mission.
    scaled : whether a scale is given, which stands in the place of a unit.
    missing : numbers and words of the log that stand for none.
    up : whether the axis points up, of a depth; None where it is not said.
    equals, above : of a flag, when it is true.
    row : the number of the first row, for a column that numbers them.
    """

    columns: tuple[str, ...] = ()
    constant: Any = None
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    scaled: bool = False
    missing: Missing = ()
    up: bool | None = None
    equals: Any = None
    above: float | None = None
    row: int | None = None


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
    mapping : that it stands in, for messages.
    part : which of the sections of its table it is.
    """

    table: str
    cells: dict[str, Cell]
    options: dict[str, Any]
    rotation: tuple[str, tuple[Any, ...]] | None
    groups: dict[str, str]
    missing: dict[str, Missing]
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
                raise self.error(
                    table, "", f"[{table}] is no table of a mission{near or ';'} expected {', '.join(COLUMNS)}"
                )
            for k, part in enumerate(content if isinstance(content, list) else [content]):
                self._part = k
                self.sections.append(self._section(table, {**_fitting(defaults, table, part), **part}))
        if not self.sections:
            raise GraphFileError("has no section; expected one for each table, such as [dvl]", path)

    def _refused(self, table: str, key: str, message: str) -> GraphFileError:
        """An error in the section that is being read."""
        return self.error(table, key, message, self._part)

    def _section(self, table: str, content: Mappings[str, Any]) -> Section:
        """A section with its groups taken apart."""
        options = {name: value for name, value in content.items() if name in OPTIONS}
        for name, value in options.items():
            self._refuse_option(table, name, value)
        cells: dict[str, Cell] = {}
        groups: dict[str, str] = {}
        rotation = None
        known = COLUMNS[table]
        for name, value in content.items():
            columns = tuple(column for column in GROUPS.get(name, ()) if column in known)
            if name in OPTIONS:
                continue
            if name in ROTATIONS and set(ANGLES) <= set(known):
                rotation = name, self._parts(table, name, value)
            elif columns:
                if not isinstance(value, list) or len(value) != len(columns):
                    raise self._refused(table, name, f"{name} is {value!r}; expected a list for {', '.join(columns)}")
                cells |= {column: self._cell(table, name, column, v) for column, v in zip(columns, value, strict=True)}
                groups |= dict.fromkeys(columns, name)
            elif name in known or (name in PLACES_ON_EARTH and {"x_m", "y_m"} <= set(known)):
                cells[name] = self._cell(table, name, name, value)
            else:
                advice = _advice(name, value, known)
                raise self._refused(
                    table, name, f"{table}.csv has no column {name!r}{advice}; it has {', '.join(known)}"
                )
        missing = self._missing(table, options.get("missing", ()), [*cells, *groups.values(), *(rotation or ())[:1]])
        for column, cell in cells.items():
            if cell.columns and not cell.missing:
                of_group = missing.get(groups.get(column, ""), ())
                cells[column] = replace(cell, missing=missing.get(column, of_group))
        return Section(table, cells, options, rotation, groups, missing, self, self._part)

    def _missing(self, table: str, value: Any, keys: Sequence[str]) -> dict[str, Missing]:
        """What stands for none, by the keys of a section."""
        if not isinstance(value, dict):
            return dict.fromkeys(keys, _several(value))
        for key in value:
            if key not in keys:
                near = did_you_mean(key, keys) or ";"
                raise self._refused(
                    table, "missing", f"missing: {key!r} is not mapped here{near} it has {', '.join(keys)}"
                )
        return {key: _several(part) for key, part in value.items()}

    def _parts(self, table: str, name: str, value: Any) -> tuple[Any, ...]:
        """The columns of a quaternion or a matrix; of a field of a message those below it."""
        count, order = ROTATIONS[name]
        if name == "quaternion" and isinstance(value, str):
            return tuple(f"{value}.{axis}" for axis in "xyzw")
        kinds = {isinstance(part, str) for part in value} if isinstance(value, list) else set()
        if len(kinds) != 1 or len(value) != count or not (True in kinds or all(map(is_number, value))):
            raise self._refused(
                table, name, f"{name} is {value!r}; expected a list of {count} columns, or of {count} numbers: {order}"
            )
        return tuple(value)

    def _cell(self, table: str, place: str, column: str, value: Any) -> Cell:
        """One column of a section, whose place is its own name or that of its group."""

        def refuse(problem: str) -> GraphFileError:
            return self._refused(table, place, f"{column}: {problem}")

        kind = mission_unit(column)[0]
        if isinstance(value, str) and column not in ("name", "kernel"):
            return Cell((value,))
        if isinstance(value, bool) and column != "valid":
            raise refuse(f"{value!r} is not possible; expected the name of a column, a number or {{ column = ... }}")
        if is_number(value):
            if not abs(value) < FINITE:
                raise refuse(f"{value!r:.30} is not possible; expected a finite number or the name of a column")
            if sigmas_out(column, float(value)):
                write = f"{column} = {example(table, column)}"
                raise refuse(f"{value!r} is not possible; expected {sigma_words(column)}; write one, such as {write}")
        if isinstance(value, str) and "\n" in value:
            raise refuse(f"{value!r:.30} is not possible; expected one line")
        if isinstance(value, bool | str) or is_number(value):
            return Cell(constant=value)
        if not isinstance(value, dict):
            raise refuse(f"{value!r} is not possible; expected the name of a column, a number or {{ column = ... }}")
        for key in value:
            if key not in CELL:
                raise refuse(
                    f"{key!r} is no key of a column{did_you_mean(key, CELL) or ';'} expected {', '.join(CELL)}"
                )
        numbers = {key: value[key] for key in ("sign", "scale", "offset", "above") if key in value}
        for key, number in numbers.items():
            expected = {"sign": "1 or -1", "scale": "a finite number other than 0"}.get(key, "a finite number")
            numeric = is_number(number) and abs(number) < FINITE
            if not numeric or (key == "sign" and number not in (-1, 1)) or (key == "scale" and number == 0):
                raise refuse(f"{key} is {number!r:.30}; expected {expected}")
        if "missing" in value and not _stand_for_none(value["missing"]):
            raise refuse(f"missing is {value['missing']!r}; expected a number, a word or a list of them")
        if not isinstance(value.get("equals", ""), str | bool | int | float):
            raise refuse(f"equals is {value['equals']!r}; expected a word, a number, true or false")
        unit = value.get("unit", "")
        if unit and (not kind or dimension(str(unit)) != kind):
            pressure = "; of a pressure give scale, such as 9.94e-5 for Pa in sea water, and offset"
            cure = pressure if dimension(str(unit)) == "pressure" and column == "z_m" else ""
            raise refuse(f"unit {unit!r} is not one of {known_units(kind)}{cure}")
        if unit and "scale" in value:
            raise refuse("unit and scale are both given; scale alone stands for both")
        if "up" in value and (column != "z_m" or not isinstance(value["up"], bool)):
            raise refuse("up = true is for z_m alone, of a column that is larger where it is higher")
        if "row" in value:
            row = value["row"]
            if not set(value) <= {"row", "scale", "offset"} or not is_whole(row) or abs(row) > WHOLE:
                raise refuse(
                    f"row is {row!r:.30}; expected the number of the first row, such as {{ row = 0 }}, also with scale "
                    "and offset"
                )
            return Cell(row=value["row"], scale=float(value.get("scale", 1)), offset=float(value.get("offset", 0)))
        names = value.get("column", ())
        names = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, list) else ()
        if not names or not all(isinstance(name, str) for name in names):
            raise refuse("no column of the log; expected { column = ... }")
        if len(names) > 1 and not (column.startswith("time_") or (column in PLACES_ON_EARTH and len(names) == 2)):
            raise refuse(
                "several columns; only a date and a time are joined, and a latitude or longitude with its side"
            )
        sign = -1.0 if value.get("up") else float(value.get("sign", 1))
        return Cell(
            names,
            unit=str(unit),
            scale=sign * float(value.get("scale", 1)),
            offset=float(value.get("offset", 0)),
            scaled="scale" in value,
            missing=_several(value.get("missing", ())),
            up=value.get("up"),
            equals=value.get("equals"),
            above=value.get("above"),
        )

    def _refuse_option(self, table: str, name: str, value: Any) -> None:
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
            "missing": all(map(_stand_for_none, value.values() if isinstance(value, dict) else [value])),
            "where": isinstance(value, dict) and set(value) == {"column", "equals"},
        }.get(name, isinstance(value, str) and bool(value))
        if not good:
            near = did_you_mean(value, FRAMES) if name == "frame" else ""
            raise self._refused(table, name, f"{name} is {value!r}; expected {OPTIONS[name]}{near}")


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
    """Whether it is the name of axes."""
    try:
        return isinstance(value, str) and all(part in FRAMES for part in value.split("/")) and bool(axes(value))
    except OptionError:
        return False


def _several(value: Any) -> Missing:
    """A list as it stands, one value as the only one."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _stand_for_none(value: Any) -> bool:
    """Whether it is a number, a word or a list of them."""
    parts = _several(value)
    return bool(parts) and all(isinstance(v, str) or (is_number(v) and abs(v) < FINITE) for v in parts)


def _is_section(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and all(isinstance(part, dict) for part in value))


def _fitting(defaults: Mappings[str, Any], table: str, content: Mappings[str, Any]) -> dict[str, Any]:
    """What stands above all sections and is for this one, too; a row that is of a pose is of no time."""
    columns = COLUMNS[table] if "i" not in content or table == "poses" else ()
    return {name: value for name, value in defaults.items() if name in OPTIONS or name in columns}


def _advice(name: str, value: object, known: tuple[str, ...]) -> str:
    """The line to write in the place of a key that is no column; nothing where no column is like it."""
    shown = value if isinstance(value, str | int | float) else "..."
    near = did_you_mean(name, [*known, *OPTIONS])
    if column := re.search(r"did you mean '(\w+)'", near):
        return f"{near}; write {column[1]} = {_toml(shown)}"
    return near


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def required(section: Section) -> list[str]:
    """Columns of a table that must be mapped: not those that may be left out, nor the flag of a DVL."""
    table, tables = section.table, [other.table for other in section.mapping.sections]
    return [name for name in COLUMNS[table] if name not in (*optional(table, tables), "valid")]
