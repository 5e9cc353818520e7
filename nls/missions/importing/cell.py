"""One column of a section of a mapping: a column of the log, how its cells are read, or a constant."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.algebra import Array, Mask
from models.errors import GraphFileError
from models.options import did_you_mean, is_number, is_whole
from nls.missions.folder.columns import BOUNDS, GEODETIC, LARGEST, MAY_BE_0, SMALLEST
from nls.missions.importing.headers import UNITS, dimension, mission_unit
from nls.missions.importing.templates import example
from nls.missions.importing.text_log import Missing

KEYS = ("column", "unit", "sign", "scale", "offset", "missing", "up", "equals", "above", "row")
FINITE = 1e300  # numbers below are numbers of 64 bits
NUMBERS = {"sign": "1 or -1", "scale": "a finite number other than 0"}  # else a finite number
ZERO = (*MAY_BE_0, "sigma")  # a sigma of 0 in calibration.csv holds the value


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

    @property
    def source(self) -> Any:
        """The column of the log whose numbers count, or the constant."""
        return self.columns[0] if self.columns else self.constant


def read_cell(table: str, column: str, value: Any, refused: Callable[[str], GraphFileError]) -> Cell:
    """One column of a section.

    Parameters
    ----------
    table, column : of the mission.
    value : in the mapping.
    refused : the error at its line with a sentence.

    Raises
    ------
    GraphFileError
        A value that cannot be.
    """

    def refuse(problem: str) -> GraphFileError:
        return refused(f"{column}: {problem}")

    kind = mission_unit(column)[0]
    if isinstance(value, str) and column not in ("name", "kernel"):
        return Cell((value,))
    if is_number(value):
        if not abs(value) < FINITE:
            raise refuse(f"{value!r:.30} is not possible; expected a finite number or the name of a column")
        if sigmas_out(column, float(value)):
            write = f"{column} = {example(table, column)}"
            raise refuse(f"{value!r} is not possible; expected {sigma_words(column)}; write one, such as {write}")
        return Cell(constant=value)
    if isinstance(value, str) and "\n" in value:
        raise refuse(f"{value!r:.30} is not possible; expected one line")
    if isinstance(value, str) or (isinstance(value, bool) and column == "valid"):
        return Cell(constant=value)
    if not isinstance(value, dict):
        raise refuse(f"{value!r} is not possible; expected the name of a column, a number or {{ column = ... }}")
    for key in value:
        if key not in KEYS:
            raise refuse(f"{key!r} is no key of a column{did_you_mean(key, KEYS) or ';'} expected {', '.join(KEYS)}")
    for key in ("sign", "scale", "offset", "above"):
        number = value.get(key, 1)
        numeric = is_number(number) and abs(number) < FINITE
        if not numeric or (key == "sign" and number not in (-1, 1)) or (key == "scale" and number == 0):
            raise refuse(f"{key} is {number!r:.30}; expected {NUMBERS.get(key, 'a finite number')}")
    if "missing" in value and not stand_for_none(value["missing"]):
        raise refuse(f"missing is {value['missing']!r}; expected a number, a word or a list of them")
    if not isinstance(value.get("equals", ""), str | bool | int | float):
        raise refuse(f"equals is {value['equals']!r}; expected a word, a number, true or false")
    unit = value.get("unit", "")
    if unit != "" and (not kind or dimension(str(unit)) != kind):
        pressure = "; of a pressure give scale, such as 9.94e-5 for Pa in sea water, and offset"
        cure = pressure if dimension(str(unit)) == "pressure" and column == "z_m" else ""
        known = ", ".join(UNITS[kind]) if kind else "none: it is a plain number"
        raise refuse(f"unit {unit!r} is not one of {known}{cure}")
    if unit and "scale" in value:
        raise refuse("unit and scale are both given; scale alone stands for both")
    if "up" in value and (column != "z_m" or not isinstance(value["up"], bool)):
        raise refuse("up = true is for z_m alone, of a column that is larger where it is higher")
    scale, offset = float(value.get("scale", 1)), float(value.get("offset", 0))
    if "row" in value:
        row = value["row"]
        if not set(value) <= {"row", "scale", "offset"} or not is_whole(row) or abs(row) > 2**53:
            expected = "expected the number of the first row, such as { row = 0 }, also with scale and offset"
            raise refuse(f"row is {row!r:.30}; {expected}")
        return Cell(row=row, scale=scale, offset=offset)
    names = value.get("column", ())
    names = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, list) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise refuse("no column of the log; expected { column = ... }")
    if len(names) > 1 and not (column.startswith("time_") or (column in GEODETIC and len(names) == 2)):
        raise refuse("several columns; only a date and a time are combined, and a latitude or longitude with its side")
    scale *= -1.0 if value.get("up") else float(value.get("sign", 1))
    cell = Cell(names, unit=str(unit), scale=scale, offset=offset, scaled="scale" in value)
    others = {key: value[key] for key in ("up", "equals", "above") if key in value}
    return replace(cell, missing=none_words(value.get("missing", ())), **others)


def none_words(value: Any) -> Missing:
    """A list as it stands, one value as the only one."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def stand_for_none(value: Any) -> bool:
    """Whether a value is a number, a word or a list of them."""
    parts = none_words(value)
    return bool(parts) and all(isinstance(v, str) or (is_number(v) and abs(v) < FINITE) for v in parts)


def sigma_words(column: str) -> str:
    """The numbers that a column of standard deviations may have, in words.

    Examples
    --------
    >>> sigma_words("sigma_x_m"), sigma_words("scale")
    ('a standard deviation above 0, 1e-12 to 1e12', '0 or above, up to 1e12')
    """
    above = f"a standard deviation above 0, {' to '.join(BOUNDS)}"
    return f"0 or above, up to {BOUNDS[1]}" if column in ZERO else above


def sigmas_out(column: str, numbers: Array | float) -> Mask:
    """Which numbers a column of standard deviations cannot have; none of another column.

    Examples
    --------
    >>> sigmas_out("sigma_x_m", np.array([-2.0, 0.0, 2.0])).tolist(), bool(sigmas_out("scale", 0.0))
    ([True, True, False], False)
    """
    is_sigma, smallest = column in ZERO or column.startswith("sigma"), 0.0 if column in ZERO else SMALLEST
    return np.asarray(is_sigma & ((numbers < smallest) | (numbers > LARGEST)))
