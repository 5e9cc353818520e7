"""Columns of a log in the unit of the mission, by the mapping, the header or a row of units: numbers, sides, times.

Times are numbers in any unit, or text. Those since 1970 stay whole nanoseconds until a zero is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Index, Mask
from models.listing import some
from nls.missions.folder.columns import SENTINELS
from nls.missions.importing.cell import Cell
from nls.missions.importing.dates import EXAMPLE, LATEST, NANOSECONDS, formats, since_1970
from nls.missions.importing.headers import convert, dimension, factor, header_unit, mission_unit
from nls.missions.importing.mapping import Section
from nls.missions.importing.text_log import MISSING, Log, is_number

FULL_TURN = 2 * np.pi
LARGEST = {"lat_deg": 90.0, "lon_deg": 180.0}
SIDES = {
    "lat_deg": {"n": 1.0, "north": 1.0, "s": -1.0, "south": -1.0},
    "lon_deg": {"e": 1.0, "east": 1.0, "w": -1.0, "west": -1.0},
}
CLOCKS = {"utc", "gmt", "gps", "tai", "unix", "posix", "epoch", "local"}  # in brackets behind a time, which are no unit
EPOCH = 1e8  # s, of 1973: no log is as long
BY_SIZE = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (EPOCH, "s"))  # of times since 1970 without a unit
DAY, WEEK = 86_400 * NANOSECONDS, 604_800 * NANOSECONDS
ONE_DAY = "1970-01-01"  # that times of the day are of until their date is added
COUNTS = (  # numbers from 2000 to 2050, what they count, and the keys that make them seconds since 1970
    (10957, 29220, "days since 1970", 'unit = "day"'),
    (36526, 55000, "days of a spreadsheet", 'unit = "day", offset = -2209161600'),
    (55000, 69808, "modified Julian days", 'unit = "day", offset = -3506716800'),
    (730486, 748750, "days of MATLAB", 'unit = "day", offset = -62167305600'),
    (2451544, 2469808, "Julian days", 'unit = "day", offset = -210866760000'),
    (1.259e17, 1.417e17, "ticks of Windows", "scale = 1e-7, offset = -11644473600"),
    (6.308e17, 6.467e17, "ticks of .NET", "scale = 1e-7, offset = -62135596800"),
)


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
        return largest, ("degE7" if largest >= 1e5 else "ddmm") if largest > LARGEST[column] else ""
    if mission_unit(column)[1] != "rad":
        return largest, ""
    degrees = finite if unsaid else np.degrees(finite)
    steps = np.abs(np.diff(degrees, prepend=0.0))
    if steps.max(initial=0.0) > 720:  # a heading that is not wrapped grows in smaller ones
        return float(degrees.max()), "cdeg"
    return largest, "deg" if unsaid and largest > FULL_TURN else ""


def _refuse_size(section: Section, column: str, numbers: Array, converted: Array, unsaid: str) -> None:
    """Refuse angles that are too large for their unit; says the unit that they may have, or which of them are none."""
    own, name = mission_unit(column)[1], section.cells[column].columns[0]
    largest, unit = _unit_by_size(column, converted, bool(unsaid))
    none = np.isin(np.abs(numbers), SENTINELS)
    if unit and none.any() and _unit_by_size(column, converted[~none], bool(unsaid))[1] in ("", "deg"):
        special = [int(number) for number in np.unique(numbers[none])]
        write = f"`missing = {special[0] if len(special) == 1 else special}` in [{section.table}] of the mapping"
        rest = f"which loggers write for none; write {write}"
        raise section.error(column, f"{name!r} is {some(special)} in {none.sum()} rows, {rest}")
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
        few = log.part(slice(0, 20))  # in which a column of letters shows itself
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
            cure = f"expected {', '.join(sides)}; correct {column} in the mapping"
            raise log.error(k, f"{letters[0]}: {word[:40]!r} is no side; {cure}")
        if sides.get(word) == -1 and numbers[k] < 0:
            cure = f'write {column} = "{name}", as its sign says the side'
            raise log.error(k, f"{name} is negative and {letters[0]} is {word!r}; {cure}")
    return np.asarray(numbers * np.array([sides.get(word, np.nan) for word in words]))


# --- times ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stamps:
    """The times of a column.

    Attributes
    ----------
    present : (n,) where there is one.
    ns : (n,) nanoseconds, 0 where there is none.
    since_1970 : whether they are; others have a zero of their own.
    """

    present: Mask
    ns: Index
    since_1970: bool

    def relative(self, zero: int) -> Array:
        """Seconds since a zero, ns since 1970; as they stand where they have a zero of their own."""
        return np.asarray((self.ns - zero if self.since_1970 else self.ns) / NANOSECONDS)

    def take(self, index: Index) -> Stamps:
        """Some of the times."""
        return Stamps(self.present[index], self.ns[index], self.since_1970)


def stamps(section: Section, log: Log, column: str, notes: list[str]) -> Stamps:
    """The times in a column of a log.

    Raises
    ------
    GraphFileError
        A cell that is no time; a unit that cannot be.
    """
    cell = section.cells[column]
    parts = [log.words(name, cell.missing) for name in cell.columns]
    present = np.all([[word.lower() not in MISSING for word in words] for words in parts], axis=0)
    words = [" ".join(words) for words in zip(*parts, strict=True)]
    first = words[int(np.argmax(present))] if present.any() else "0"
    if len(parts) > 1 or "time_format" in section.options or (not is_number(first) and any(map(str.isdigit, first))):
        stamp = Stamps(present, _of_texts(section, log, column, words, present, notes), True)
    else:
        stamp = _of_numbers(section, log, column, notes)
    return _on_day(section, log, stamp, notes) if "date" in section.options else stamp


def _of_numbers(section: Section, log: Log, column: str, notes: list[str]) -> Stamps:
    """Times that are numbers; whole ones since 1970 stay exact."""
    cell = section.cells[column]
    (name,) = cell.columns
    whole = log.whole(name)
    numbers = log.numbers(name, cell.missing)
    present = np.isfinite(numbers)
    unit, scale = _unit(section, log, column, numbers[present], notes)
    seconds = np.where(present, numbers * scale * cell.scale + cell.offset, 0.0)
    _refuse_late(section, log, column, seconds)
    days = np.floor(seconds)
    ns = days.astype(np.int64) * NANOSECONDS + np.rint((seconds - days) * 1e9).astype(np.int64)
    if whole is not None and unit in ("ns", "us", "ms", "s") and not cell.scaled:
        ns = np.where(present, whole * round(NANOSECONDS * scale) + round(cell.offset * NANOSECONDS), 0)
    return Stamps(present, ns, _size(seconds[present]) >= EPOCH)


def _size(times: Array) -> float:
    """The median magnitude: one cell that is wrong changes no unit."""
    return float(np.median(np.abs(times))) if len(times) else 0.0


def _refuse_late(section: Section, log: Log, column: str, seconds: Array) -> None:
    """Refuse seconds (n,) that no log has; as nanoseconds they may be no whole numbers of 64 bits."""
    late, rows, name = np.abs(seconds) >= LATEST, np.arange(len(log)), section.cells[column].columns[-1]
    cure = f"give the right unit and offset of {column} in [{section.table}] of the mapping"
    log.refuse(late, rows, lambda k: f"{name}: {seconds[k]:.6g} s is no time since 1970, nor of a dive; {cure}")


def _unit(section: Section, log: Log, column: str, numbers: Array, notes: list[str]) -> tuple[str, float]:
    """The unit of times and what one is in seconds: as given, as the header has it, or by size, which is noted."""
    cell = section.cells[column]
    if cell.scaled:
        return "", 1.0
    (name,) = cell.columns
    unit = unit_of(section, column, log)
    if unit in ("", "day") and not cell.offset and len(numbers):
        steps = np.diff(numbers)
        step = np.median(steps[steps > 0]) if (steps > 0).any() else np.inf
        for low, high, count, keys in COUNTS:
            fast = unit == "day" or low > LATEST or step < 5e-4  # s: no table is as fast, and as many days are 43 s
            if low <= numbers[0] < high and fast and not (unit and keys == 'unit = "day"'):
                write = f'`{column} = {{ column = "{name}", {keys} }}`'
                reason = f"{count}; write {write} in [{section.table}] of the mapping"
                raise section.error(column, f"{name!r} begins with {numbers[0]:.10g}, in steps of {step:.3g}: {reason}")
    if not unit:
        size = _size(numbers)
        unit = next((unit for limit, unit in BY_SIZE if size >= limit), "s")
        since = " since 1970, by their size" if size >= EPOCH else ""
        notes.append(f"{log.title}: {name!r} names no unit; its times are taken to be {unit}{since}")
    scale = factor(unit, "time_s")
    return next((u for u in ("ns", "us", "ms", "s") if factor(u, "time_s") == scale), unit), scale


def _of_texts(section: Section, log: Log, column: str, words: Sequence[str], present: Mask, notes: list[str]) -> Index:
    """Times (n,) of texts, ns since 1970; without a zone they are of UTC, which is noted."""
    cell, options, rows = section.cells[column], section.options, np.flatnonzero(present)
    day, texts = ONE_DAY if "date" in options else "", [words[k] for k in rows.tolist()]
    since = np.zeros(len(words), dtype=np.int64)
    try:
        since[present], zoned = since_1970(texts, options.get("time_format", ""), day)
    except ValueError as error:
        k, problem = error.args
        raise log.error(int(rows[k]), f"{texts[k][:40]!r} {problem}; {_cure(section, texts, k, day)}") from error
    if not zoned:
        notes.append(f"{log.title}: {cell.columns[-1]!r} names no zone; its times are taken to be UTC")
    _refuse_late(section, log, column, np.where(present, since / NANOSECONDS + cell.offset, 0.0))
    return since + round(cell.offset * NANOSECONDS)


def _cure(section: Section, texts: Sequence[str], k: int, day: str) -> str:
    """The text to write where text k is not read."""
    where = f"in [{section.table}] of the mapping"
    for words in (texts, texts[k : k + 1]):
        if fitting := formats(words, day):
            return "write " + " or ".join(f'`time_format = "{form}"`' for form in fitting) + f" {where}"
        if formats(words, "" if day else ONE_DAY):
            other = f'write `date = "{EXAMPLE}"`, the day of the first row, {where}'
            return f"it has a date; leave date out of [{section.table}]" if day else f"it has no date; {other}"
    return (
        f'expected such as 2024-12-05T22:12:34.25Z, or as `time_format = "%d.%m.%Y %H:%M:%S"` {where} says; '
        f"`missing = {texts[k][:40]!r}` there where it stands for none; a date and a time of two columns are "
        '{ column = ["DATE", "TIME"] }'
    )


def _on_day(section: Section, log: Log, stamp: Stamps, notes: list[str]) -> Stamps:
    """Times of the day, or of the week of GPS, on their date; where they fall by as much the next has begun."""
    rows = np.flatnonzero(stamp.present)
    ns = stamp.ns[rows]
    period = DAY if ns.max(initial=0) <= DAY else WEEK
    problem = f"is later than a day or a week of GPS; leave date out of [{section.table}] of the mapping"
    log.refuse(np.abs(ns) > period, rows, lambda k: f"{ns[k] / NANOSECONDS:.10g} s {problem}")
    if (falls := np.diff(ns) < -period // 2).any():
        place = log.place(int(rows[1:][np.argmax(falls)]))
        notes.append(f"{section.table}: the times begin anew at {place}, {period // NANOSECONDS} s later")
        ns = np.unwrap(ns, period=period).astype(np.int64)
    since = np.zeros(len(stamp.present), dtype=np.int64)
    since[rows] = ns + np.datetime64(str(section.options["date"]), "ns").astype(np.int64)
    return Stamps(stamp.present, since, True)
