"""Numbers of a log in the unit of the mission: by the mapping, the header or a row of units; sides of the earth."""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from models.listing import some
from nls.missions.checks.special import NUMBERS
from nls.missions.importing.cell import Cell
from nls.missions.importing.mapping import Section
from nls.missions.importing.text_log import MISSING, Log
from nls.missions.importing.units import convert, dimension, factor, header_unit, mission_unit

__all__ = ["FULL_TURN", "convert_column", "hemispheres", "unit_of"]

FULL_TURN = 2 * np.pi
LARGEST = {"lat_deg": 90.0, "lon_deg": 180.0}
MOST_TURN = 720.0  # deg, between two rows or at the first one; a heading that is not wrapped grows in smaller steps
LEAST_E7 = 1e5  # degrees and minutes are up to 18000
SIDES = {
    "lat_deg": {"n": 1.0, "north": 1.0, "s": -1.0, "south": -1.0},
    "lon_deg": {"e": 1.0, "east": 1.0, "w": -1.0, "west": -1.0},
}
CLOCKS = {"utc", "gmt", "gps", "tai", "unix", "posix", "epoch", "local"}  # in brackets behind a time, which are no unit
LOOKED_AT = 20  # rows in which a column of letters shows itself


def unit_of(section: Section, column: str, log: Log) -> str:
    """The unit of a column of a mission in the log, by the mapping, its header or a row of units; empty where none is.

    Raises
    ------
    GraphFileError
        The header has a unit of another kind, or one that is not known.
    """
    kind, own = mission_unit(column)
    cell = section.cells[column]
    name = cell.columns[0]
    named, bracket = header_unit(name)
    header = log.units.get(name) or named
    if cell.unit or dimension(header) == kind:
        return cell.unit or header
    states = (bracket or name in log.units) and not (kind == "time" and CLOCKS & set(header.lower().split()))
    if states or dimension(header) not in ("", "fraction"):
        known = dimension(header) or "an unknown unit"
        write = f'{column} = {{ column = "{name}", unit = "{own}" }}'
        cure = f"write {write} if it is" if known != "pressure" else "scale and offset turn a pressure into a depth"
        raise section.error(column, f"{name!r} is in {header}, {known}; {column} is a {kind}, {own}; {cure}")
    return ""


def convert_column(section: Section, column: str, log: Log, numbers: Array, notes: list[str]) -> Array:
    """Numbers (n,) of a column in the unit of the mission.

    Raises
    ------
    GraphFileError
        The name of the column has a unit of another kind, or its numbers are too large for the unit.
    """
    kind, own = mission_unit(column)
    if not kind:
        return numbers
    given, name = section.cells[column].unit, section.cells[column].columns[0]
    named = header_unit(name)[0]
    if given and dimension(named) == kind and factor(named, column) != factor(given, column):
        notes.append(f"{log.title}: {name!r} is taken to be {given}, as the mapping says")
    if not (unit := unit_of(section, column, log)):
        _refuse_size(section, column, numbers, numbers, "names no unit and ")
        notes.append(f"{log.title}: {name!r} names no unit; it is taken to be {own}")
        unit = own
    try:
        converted = convert(numbers, unit, column)
    except ValueError as error:
        k, sentence = error.args
        raise log.error(k, f"{name}: {sentence}; correct unit of {column} in the mapping") from error
    if not given and kind == "angle":
        _refuse_size(section, column, numbers, converted, "")
    return converted


def _unit_by_size(column: str, numbers: Array, unsaid: bool) -> tuple[float, str]:
    """The largest of angles (n,), and the unit that they have where it is too large for theirs."""
    finite = np.abs(numbers[np.isfinite(numbers)])
    largest = float(finite.max(initial=0.0))
    if column in LARGEST:
        return largest, ("degE7" if largest >= LEAST_E7 else "ddmm") if largest > LARGEST[column] else ""
    if mission_unit(column)[1] != "rad":
        return largest, ""
    degrees = finite if unsaid else np.degrees(finite)
    if max(degrees[:1].max(initial=0.0), np.abs(np.diff(degrees)).max(initial=0.0)) > MOST_TURN:
        return float(degrees.max()), "cdeg"
    return largest, "deg" if unsaid and largest > FULL_TURN else ""


def _refuse_size(section: Section, column: str, numbers: Array, converted: Array, unsaid: str) -> None:
    """Refuse angles that are too large for their unit; says the unit that they may have, or which of them are none."""
    own, name = mission_unit(column)[1], section.cells[column].columns[0]
    largest, unit = _unit_by_size(column, converted, bool(unsaid))
    none = np.isin(np.abs(numbers), NUMBERS)
    if unit and none.any() and _unit_by_size(column, converted[~none], bool(unsaid))[1] in ("", "deg"):
        special = [int(number) for number in np.unique(numbers[none])]
        write = f"`missing = {special[0] if len(special) == 1 else special}` in [{section.table}] of the mapping"
        raise section.error(
            column, f"{name!r} is {some(special)} in {none.sum()} rows, which loggers write for none; write {write}"
        )
    if unit:
        expected = "radians" if own == "rad" and unsaid else "degrees"
        write = f'{column} = {{ column = "{name}", unit = "{unit}" }}'
        other = f', or unit = "{"deg" if own == "rad" else own}" if it is' if unit == "cdeg" else ""
        raise section.error(column, f"{name!r} {unsaid}is up to {largest:.6g}, no {expected}; write {write}{other}")


def hemispheres(section: Section, column: str, cell: Cell, log: Log, numbers: Array) -> Array:
    """Latitudes or longitudes (n,), negative in the south and in the west.

    Raises
    ------
    GraphFileError
        A cell that names no side, or one beside a negative number; a column of sides that the mapping leaves out.
    """
    if column not in SIDES:
        return numbers
    sides, (name, *letters) = SIDES[column], cell.columns
    if not letters:
        few = log.part(slice(0, LOOKED_AT))
        for other in log.names:
            kinds = {word.lower() for word in few.words(other)} - MISSING if log.names.count(other) == 1 else set()
            if kinds and kinds <= sides.keys() and cell.scale > 0:
                words = log.words(other)
                if any(sides.get(word.lower()) == -1 and x > 0 for word, x in zip(words, numbers, strict=True)):
                    write = f'{column} = {{ column = ["{name}", "{other}"] }}'
                    raise section.error(column, f"{name!r} has no sign and {other!r} names the side; write {write}")
        return numbers
    words = [word.lower() for word in log.words(letters[0], cell.missing)]
    for k, word in enumerate(words):
        if word not in sides and word not in MISSING:
            expected = ", ".join(sides)
            raise log.error(
                k, f"{letters[0]}: {word[:40]!r} is no side; expected {expected}; correct {column} in the mapping"
            )
        if sides.get(word) == -1 and numbers[k] < 0:
            cure = f'write {column} = "{name}", as its sign says the side'
            raise log.error(k, f"{name} is negative and {letters[0]} is {word!r}; {cure}")
    return np.asarray(numbers * np.array([sides.get(word, np.nan) for word in words]))
