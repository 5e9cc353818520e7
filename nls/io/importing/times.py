"""Times of a log: numbers in any unit, or ISO 8601; those since 1970 stay whole nanoseconds until a zero is known."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Index, Mask
from nls.io.importing.mapping import Cell
from nls.io.importing.text_log import MISSING, Log
from nls.io.importing.units import dimension, factor, header_unit

__all__ = ["Stamps", "iso", "stamps"]

ISO = re.compile(
    r"((?:19|20|21)\d\d-\d\d-\d\d)[T ]+(\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?) ?(Z|UTC|[+-]\d\d:?\d\d|[+-]\d\d)?", re.I
)
LATEST = 7e9  # s, of 2191
EPOCH = 1e8  # s, of 1973: no log is as long
NANOSECONDS = 1_000_000_000
BY_SIZE = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (EPOCH, "s"))  # of times since 1970 without a unit


@dataclass(frozen=True)
class Stamps:
    """The times of a column.

    Attributes
    ----------
    present : (n,) where there is one.
    seconds : (n,) of times with a zero of their own; None of times since 1970.
    nanoseconds : (n,) since 1970, or None.
    """

    present: Mask
    seconds: Array | None
    nanoseconds: Index | None

    def relative(self, zero: int) -> Array:
        """Seconds since a zero, ns since 1970; as they stand where they have a zero of their own."""
        if self.nanoseconds is None:
            assert self.seconds is not None
            return self.seconds
        return np.asarray((self.nanoseconds - zero) / NANOSECONDS)


def stamps(log: Log, cell: Cell, column: str, notes: list[str]) -> Stamps:
    """The times in a column of a log.

    Raises
    ------
    GraphFileError
        A cell that is no time.
    """
    if len(cell.columns) > 1:
        parts = [log.words(name, cell.missing) for name in cell.columns]
        return _iso(log, [" ".join(words) for words in zip(*parts, strict=True)], cell, notes)
    (name,) = cell.columns
    words = log.words(name, cell.missing) if not log.units.get(name) else []
    first = next((word for word in words if word.lower() not in MISSING), "")
    if ISO.fullmatch(first) or ":" in first:
        return _iso(log, words, cell, notes)
    whole = log.whole(name)
    numbers = log.numbers(name, cell.missing)
    present = np.isfinite(numbers)
    unit, scale = _unit(log, cell, column, numbers[present], notes)
    if whole is not None and unit in ("ns", "us", "ms", "s") and not cell.scaled:
        step = round(NANOSECONDS * factor(unit, "time_s"))
        _refuse_late(log, np.where(present, whole * factor(unit, "time_s"), 0.0), name)
        since = whole * step
        if (np.abs(since[present]) / NANOSECONDS >= EPOCH).any():
            return Stamps(present, None, since + round(cell.offset * NANOSECONDS))
    seconds = np.where(present, numbers * scale * cell.scale + cell.offset, np.nan)
    _refuse_late(log, np.where(present, seconds, 0.0), name)
    if present.any() and np.abs(seconds[present]).max() >= EPOCH:
        since = np.zeros(len(seconds), dtype=np.int64)
        days = np.floor(seconds[present])
        since[present] = days.astype(np.int64) * NANOSECONDS + np.rint((seconds[present] - days) * 1e9).astype(np.int64)
        return Stamps(present, None, since)
    return Stamps(present, seconds, None)


def _refuse_late(log: Log, seconds: Array, name: str) -> None:
    """Refuse times that are no seconds: later than any clock, or before 1970 by as much."""
    if (late := np.abs(seconds) >= LATEST).any():
        k = int(np.argmax(late))
        raise log.error(k, f"{name}: {seconds[k]:.6g} s is no time since 1970, nor of a dive; give the right unit")


def _unit(log: Log, cell: Cell, column: str, numbers: Array, notes: list[str]) -> tuple[str, float]:
    """The unit of times and what one is in seconds: as given, as the header has it, or by size, which is noted."""
    if cell.scaled:
        return "", 1.0
    (name,) = cell.columns
    named = header_unit(name)[0]
    unit = cell.unit or next((u for u in (log.units.get(name), named) if dimension(u or "") == "time"), "")
    header = log.units.get(name) or named
    if not unit and dimension(header) not in ("", "fraction"):
        write = f'{column} = {{ column = "{name}", unit = "s" }}'
        kind = dimension(header)
        raise log.error(0, f"{name!r} is in {header}, {kind}; {column} is a time, s; write {write} if it is")
    if not unit:
        largest = np.abs(numbers).max(initial=0)
        unit = next((unit for limit, unit in BY_SIZE if largest >= limit), "s")
        since = " since 1970, by their size" if largest >= EPOCH else ""
        notes.append(f"{log.title}: {name!r} names no unit; its times are taken to be {unit}{since}")
    scale = factor(unit, "time_s")
    return next((u for u in ("ns", "us", "ms", "s") if factor(u, "time_s") == scale), unit), scale


def _iso(log: Log, words: list[str], cell: Cell, notes: list[str]) -> Stamps:
    """Times in ISO 8601; without a zone they are of UTC, which is noted."""
    matches = [
        None if word.strip(" T").lower() in MISSING else ISO.fullmatch(word) or k for k, word in enumerate(words)
    ]
    if (bad := next((match for match in matches if isinstance(match, int)), None)) is not None:
        raise log.error(
            bad,
            f"{words[bad][:40]!r} is no time of ISO 8601; expected such as 2024-12-05T22:12:34.25Z, year first; a date "
            'and a time of two columns are { column = ["DATE", "TIME"] }',
        )
    good = [match for match in matches if isinstance(match, re.Match)]
    if any(match[3] is None for match in good):
        notes.append(f"{log.title}: {cell.columns[-1]!r} names no zone; its times are taken to be UTC")
    present = np.array([match is not None for match in matches])
    since = np.zeros(len(words), dtype=np.int64)
    try:
        text = [f"{match[1]}T{match[2].replace(',', '.')}" for match in good]
        since[present] = np.array(text, dtype="datetime64[ns]").astype(np.int64)
    except ValueError as error:
        k = next(k for k, match in zip(np.flatnonzero(present), good, strict=True) if not _date(match))
        raise log.error(int(k), f"{words[k][:40]!r} is no date: {error}") from error
    zones = {zone: _zone(zone) for zone in {match[3] for match in good}}
    since[present] -= np.array([zones[match[3]] for match in good], dtype=np.int64) * NANOSECONDS
    return Stamps(present, None, since + round(cell.offset * NANOSECONDS))


def _date(match: re.Match[str]) -> bool:
    try:
        np.datetime64(f"{match[1]}T{match[2].replace(',', '.')}", "ns")
    except ValueError:
        return False
    return True


def _zone(zone: str | None) -> int:
    """Seconds that a zone is ahead of UTC."""
    if zone is None or zone.upper() in ("Z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return (-1 if zone[0] == "-" else 1) * (3600 * int(digits[:2]) + 60 * int(digits[2:]))


def iso(nanoseconds: int) -> str:
    """A time since 1970 in ISO 8601.

    Examples
    --------
    >>> iso(1733436754_250000000)
    '2024-12-05T22:12:34.250000000Z'
    """
    return f"{np.datetime64(nanoseconds, 'ns')}Z"


def parse_zero(value: object) -> int | None:
    """Nanoseconds since 1970 of a time zero in a mapping: ISO 8601 or seconds; None where it is neither."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return round(value * NANOSECONDS)
    match = ISO.fullmatch(str(value))
    if match is None or not _date(match):
        return None
    since = int(np.datetime64(f"{match[1]}T{match[2].replace(',', '.')}", "ns").astype(np.int64))
    return since - _zone(match[3]) * NANOSECONDS
