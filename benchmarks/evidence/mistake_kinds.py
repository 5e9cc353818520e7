"""All mistakes: those in the numbers of the sensors, and those in clocks, rows and words."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from mistake_base import YAW, Change, Mistake, change, rows
from mistake_missions import DEPTH, LENGTH, PLACES, SEEN, START, TIME, VELOCITIES, Survey
from mistake_sensors import of_acoustics, of_angles, of_depths, of_places, of_velocities

from models.algebra import Array

CLOCKS = {"1 s": 1.0, "3 s": 3.0, "18 s": 18.0, "1 h": 3600.0, "1 week": 604800.0}


def late(table: str, seconds: float) -> Change:
    return change(table, [TIME], lambda t: t + seconds)


def timed(table: str | None, function: Callable[[Array], Any]) -> Change:
    """Other times, of one log or of all, whose track then has times of its own."""

    def spoil(survey: Survey) -> None:
        for name in survey.logs if table is None else (table,):
            survey.logs[name][TIME] = function(survey.logs[name][TIME].astype(float))
        survey.dated = table is not None

    return spoil


def clock_of(table: str) -> tuple[str, ...]:
    """Patterns of a clock that is off."""
    off = r"time_s(?!.*% fast)|\d s (late|early)|(subtract|add) [\d.]+ s(?!.*divide)"
    return (
        rf"{table}_clock_s",
        rf"clock of {table}\b",
        rf"\b{table}\b.*({off}|midnight)",
        rf"({off}|midnight).*\b{table}\b",
    )


def us_dates(survey: Survey) -> None:
    """Month, day, year, in the times of all logs."""
    for log in survey.logs.values():
        when = np.datetime64("2026-05-06T00:00:00", "ms") + np.round(1000 * log[TIME]).astype("timedelta64[ms]")
        words = [str(x) for x in when]
        log[TIME] = np.array([f"{w[5:7]}/{w[8:10]}/{w[:4]} {w[11:]}" for w in words], dtype=object)
    survey.dated = False


def one_row(table: str, seconds: float) -> Change:
    """One row in the middle is stamped so much later."""

    def spoil(survey: Survey) -> None:
        t = survey.logs[table][TIME]
        t[len(t) // 2 + 1] += seconds

    return spoil


def shuffled(n: int) -> Any:
    return np.random.default_rng(7).permutation(n)


def off_by_one(table: str) -> Change:
    """Every row has the time of the row before."""

    def spoil(survey: Survey) -> None:
        t = survey.logs[table][TIME]
        survey.logs[table][TIME] = np.append(2 * t[0] - t[1], t[:-1])

    return spoil


def units_row(table: str) -> Change:
    """A row of units between the header and the first row."""

    def spoil(survey: Survey) -> None:
        survey.lines[table] = ",".join("s" if name == TIME else "SI" for name in survey.logs[table]) + "\n"

    return spoil


def words(table: str, column: str, word: str) -> Change:
    """A word instead of a number in some rows."""

    def spoil(survey: Survey) -> None:
        cells = survey.logs[table][column].astype(object)
        cells[4:7] = word
        survey.logs[table][column] = cells

    return spoil


def of_rows() -> Iterator[Mistake]:
    for table in ("dvl", "ahrs", "depth", "fixes", "usbl", "ship"):
        for name, seconds in CLOCKS.items():
            yield Mistake(f"{table}: {name} late", late(table, seconds), clock_of(table))
        yield Mistake(f"{table}: 18 s early", late(table, -18.0), clock_of(table))
        yield Mistake(f"{table}: times in ms", timed(table, lambda t: 1e3 * t), (*clock_of(table), "ms"))
        yield Mistake(
            f"{table}: clock 1 % fast",
            timed(table, lambda t: START + 1.01 * (t - START)),
            (rf"clock of {table}\b.*fast",),
        )
        back = (*clock_of(table), "clock of its own", f"leave out lines .*{table}")
        yield Mistake(f"{table}: one row a week back", one_row(table, -604800.0), back)
        yield Mistake(f"{table}: shuffled", rows((table,), shuffled), ("sort",))
        yield Mistake(f"{table}: rows twice", rows((table,), lambda n: np.repeat(np.arange(n), 2)), ("duplicates",))
        yield Mistake(f"{table}: times of the row before", off_by_one(table), clock_of(table))
        yield Mistake(f"{table}: a row of units", units_row(table), ("skip|rows",))
    firsts = {"dvl": VELOCITIES[0], "depth": DEPTH, "fixes": PLACES[0], "ahrs": YAW, "usbl": SEEN[0]}
    for table, column in firsts.items():
        for word in ("--.--", "INVALID"):
            yield Mistake(f"{table}: {word} in 3 rows", words(table, column, word), (f"missing = .*{word}",))
    for name, factor in {"ms": 1e3, "us": 1e6, "days": 1 / 86400, "min": 1 / 60}.items():
        yield Mistake(
            f"all: times in {name}",
            timed(None, lambda t, f=factor: f * t),
            (f'unit = "{"day" if name == "days" else name}"', "right unit of time_s"),
        )
    yield Mistake("all: midnight", timed(None, lambda t: (t + 86400 - START - LENGTH / 2) % 86400), ("midnight|86400",))
    yield Mistake("fixes: midnight", lambda s: midnight(s, "fixes"), ("midnight|86400",))
    yield Mistake(
        "all: days of a spreadsheet", timed(None, lambda t: np.round(45631 + t / 86400, 8)), ('unit = "day"|day',)
    )
    yield Mistake("all: dates as month, day, year", us_dates, ("time_format",))


def midnight(survey: Survey, table: str) -> None:
    """All logs cross midnight; one of them counts from 0 again."""
    move = 86400 - START - LENGTH / 2
    for name, log in survey.logs.items():
        log[TIME] = log[TIME] + move
        if name == table:
            log[TIME] = log[TIME] % 86400
    survey.t = survey.t + move


MISTAKES = tuple(m for of in (of_velocities, of_angles, of_depths, of_places, of_acoustics, of_rows) for m in of())
