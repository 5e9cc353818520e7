"""Dates and times of day as text: ISO 8601, any other form by ``time_format``, and the forms that a text may have."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np

from models.algebra import Index
from models.options import is_number

CLOCK_TIME = r"(?:[01]\d|2[0-3]):[0-5]\d(?::[0-5]\d(?:[.,]\d{1,9})?)?"
ISO = re.compile(rf"(\d{{4}}-\d\d-\d\d)[T ]+({CLOCK_TIME}) ?(Z|UTC|[+-](0\d|1[0-4])(:?[0-5]\d)?)?", re.I)
NANOSECONDS = 1_000_000_000
LONG = re.compile(r"([.,]\d{6})\d{1,3}(?!\d)")  # a fraction that `datetime` does not take
EXAMPLE = "2022-08-14"  # a Sunday, with which a week of GPS begins
YEARS = range(1970, 2191)  # of a log
LATEST = 7e9  # s, of 2191
PROBE = datetime(2022, 8, 25, 13, 59, 38, tzinfo=UTC)  # a format that omits one of its first four parts reads another
CLOCK = (  # text of a time of the day, its directives
    (r"(:\d\d(?:[.,]\d+)?)( ?)[+-]\d\d:?\d\d$", r"\1\2%z"),
    (r"(?<!\d)\d{1,2}:\d\d:\d\d", "%H:%M:%S"),
    (r"(?<!\d)\d{1,2}:\d\d(?!\d)", "%H:%M"),
    (r"(?<=[T ])\d{6}(?!\d)", "%H%M%S"),
    (r"(?<=%S)([.,])\d+", r"\1%f"),
    (r"(?<=[MSf])( ?)Z$", r"\1%z"),
    (r"(?i)(?<=[MSf ])[AP]M\b", "%p"),
)
SLOT = re.compile(r"(\d+|(?!UTC|GMT)[A-Za-z]{3,})")  # of a date, where the time of the day is out
ORDERS = (
    *("%m %d %Y", "%d %m %Y", "%Y %m %d", "%m %d %y", "%d %m %y", "%y %m %d", "%Y %j", "%j %Y", "%y %j", ""),
    *("%b %d %Y", "%d %b %Y", "%Y %b %d", "%b %d %y", "%d %b %y", "%a %b %d %Y", "%a %d %b %Y"),
)


def is_date(value: object) -> bool:
    """Whether a value is a day, year first.

    Examples
    --------
    >>> is_date("2022-08-14"), is_date("14.08.2022")
    (True, False)
    """
    try:
        return date.fromisoformat(str(value)).year in YEARS
    except ValueError:
        return False


def check_format(form: str, dated: bool) -> None:
    """Refuse a format that cannot be that of times, of one `dated` day or of any.

    Raises
    ------
    ValueError
        What is wrong with it.

    Examples
    --------
    >>> check_format("%d.%m.%Y %H:%M", dated=False)
    >>> check_format("%d.%m. %H:%M", dated=False)
    Traceback (most recent call last):
    ValueError: names no year; expected %Y or %y, or write `date = "2022-08-14"` beside it
    """
    if dated and re.search(r"%[YymdjbBcxG]", form):
        raise ValueError("has a date and so has date; leave date out")
    if not dated and not re.search(r"%[YyGcx]", form):
        raise ValueError(f'names no year; expected %Y or %y, or write `date = "{EXAMPLE}"` beside it')
    if "%Z" in form:
        raise ValueError("has %Z, which has no size; write %z for +02:00, or UTC as it stands")
    form = f"%Y-%m-%d {form}" if dated else form
    try:
        read = datetime.strptime(PROBE.strftime(form), form)
    except re.error as error:
        raise ValueError("has a directive twice") from error
    if (read.date(), read.hour) != (PROBE.date(), PROBE.hour):
        raise ValueError(f"reads {PROBE:%Y-%m-%d %H:%M} as {read:%Y-%m-%d %H:%M}; expected all of it, as %H or %I %p")


def since_1970(words: Sequence[str], form: str = "", day: str = "") -> tuple[Index, bool]:
    """Times (n,) of texts, ns since 1970, and whether each names its zone; of others UTC is assumed.

    Parameters
    ----------
    words : (n,) none of them empty.
    form : as of `datetime.strptime`; ISO 8601 when omitted. Its fractions of a second are read to a microsecond.
    day : that times of the day are of.

    Raises
    ------
    ValueError
        A text (row, sentence) that is no time.

    Examples
    --------
    >>> since_1970(["8/15/2022 9:59:38"], "%m/%d/%Y %H:%M:%S")
    (array([1660557578000000000]), False)
    """
    texts = [f"{day} {word}" if day else word for word in words]
    if form:
        return _of_format(texts, f"%Y-%m-%d {form}" if day else form), bool(re.search(r"%z|UTC|GMT|Z$", form))
    matches = []
    for k, text in enumerate(texts):
        match = ISO.fullmatch(text)
        if match is None or not is_date(match[1]):
            raise ValueError(k, "is no time of ISO 8601")
        matches.append(match)
    texts = [f"{match[1]}T{match[2].replace(',', '.')}" for match in matches]
    since = np.array(texts, dtype="datetime64[ns]").astype(np.int64)
    zones = {zone: _zone(zone) for zone in {match[3] for match in matches}}
    ahead = np.array([zones[match[3]] for match in matches], dtype=np.int64)
    return np.asarray(since - ahead * NANOSECONDS), None not in zones


def _of_format(texts: Sequence[str], form: str) -> Index:
    """Times (n,) of texts of a format, ns since 1970."""
    read: dict[str, datetime] = {}
    for k, text in enumerate(texts):
        if text not in read:
            try:
                when = datetime.strptime(LONG.sub(r"\1", text) if "%f" in form else text, form)
                YEARS.index(when.year)
            except ValueError as error:
                raise ValueError(k, f"does not fit {form}, of a year in {YEARS[0]} to {YEARS[-1]}") from error
            read[text] = when.replace(tzinfo=None) - (when.utcoffset() or timedelta(0))
    return np.array([read[text] for text in texts], dtype="datetime64[us]").astype("datetime64[ns]").astype(np.int64)


def formats(words: Sequence[str], day: str = "") -> list[str]:
    """The formats of which texts may be: of all of them, with the day, month first where both orders fit.

    Examples
    --------
    >>> formats(["8/5/2022 9:59:38"]), formats(["8/5/2022 9:59", "8/15/2022 9:59"]), formats(["20220815T095938Z"])
    (['%m/%d/%Y %H:%M:%S', '%d/%m/%Y %H:%M:%S'], ['%m/%d/%Y %H:%M'], ['%Y%m%dT%H%M%S%z'])
    """
    fitting = []
    for form in _candidates(words[0]):
        with suppress(ValueError):
            check_format(form, bool(day))
            since_1970(words, form, day)
            fitting.append(form)
    return list(dict.fromkeys(fitting))


def _candidates(text: str) -> Iterator[str]:
    """Formats whose directives stand where a text has numbers and names."""
    for pattern, directives in CLOCK:
        text = re.sub(pattern, directives, text)
    parts = SLOT.split(text.replace("%H", "%I") if "%p" in text else text)
    for order in ORDERS:
        slots = order.split()
        if len(parts) == 3:
            slots = ["".join(slots)]
        if len(slots) == len(parts) // 2:
            pairs = zip(slots, parts[1::2], strict=False)
            slots = [slot.swapcase() if len(part) > 3 and slot in ("%a", "%b") else slot for slot, part in pairs]
            yield "".join(between + slot for between, slot in zip(parts[::2], [*slots, ""], strict=True))


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


def parse_zero(value: Any) -> int | None:
    """Nanoseconds since 1970 of a time zero in a mapping: ISO 8601 or seconds; None where it is no time of a log."""
    if is_number(value):
        return round(value * NANOSECONDS) if abs(value) < LATEST else None
    with suppress(ValueError):
        return int(since_1970([str(value)])[0][0])
    return None
