"""Mistakes that are made with logs, each with the causes that may be named for it.

A cause is a pattern that a sentence of the program must have: the column or constant, and what is wrong with it. Where
the data cannot tell two causes apart, such as a declination from a DVL that is turned, either is right.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mistake_missions import ANGLES, DEPTH, PLACES, SEEN, TIME, VELOCITIES, Survey

from models.algebra import Array

Change = Callable[[Survey], None]
KNOT, FOOT, DEG = 3600 / 1852, 1 / 0.3048, 180 / np.pi
ROLL, PITCH, YAW = ANGLES
NAMES = {  # of columns of the logs in a mission
    **dict(zip(VELOCITIES, ("vx_m_s", "vy_m_s", "vz_m_s"), strict=True)),
    **dict(zip(ANGLES, ("roll_rad", "pitch_rad", "yaw_rad"), strict=True)),
    **dict(zip(PLACES, ("lat_deg", "lon_deg"), strict=True)),
    **dict(zip(SEEN, ("range_m", "bearing_rad", "elevation_rad"), strict=True)),
    **{DEPTH: "z_m", "z [m]": "z_m", TIME: "time_s", "lock": "valid"},
}
STATED = {"sigma_v": "dvl", "sigma_yaw": "ahrs", "sigma_z": "depth"}  # by the noise of a mapping
OFF = r"\byaw_rad\b.*(too (large|small)|offset|subtract|add|dvl_mount)"
TURNED = rf"declination_rad,|dvl_yaw_rad,|turned by|{OFF}"  # what only a ship or fixes can tell apart


@dataclass(frozen=True)
class Mistake:
    """A way to spoil a right log.

    Attributes
    ----------
    name : of the table or section of the mapping, and what was done.
    spoil : does it to a copy.
    right : patterns, any of which names the cause.
    """

    name: str
    spoil: Change
    right: tuple[str, ...]

    @property
    def table(self) -> str:
        """The table that a mission needs for it; empty where it is of all tables."""
        place, _, what = self.name.partition(": ")
        return {"all": "", "dvl_mount": "dvl", "noise": STATED.get(what.split()[0], "")}.get(place, place)

    @property
    def quantities(self) -> set[str]:
        """What of its table is wrong, in the words of the program for what nothing checks."""
        table = self.table
        if re.search("late|early|fast|times of", self.name):
            return {f"clock of {table}.csv", *["depth of depth.csv"] * (table == "depth")}
        if table == "depth":
            of = "zero of the depth" if "too deep" in self.name else "scale" if "scale" in self.name else "depth"
            return {"depth of depth.csv", f"{of} of depth.csv"}
        if table == "fixes":
            return {f"{'arm' if 'arm' in self.name else 'place'} of fixes.csv"}
        return {"heading of ahrs.csv"} if self.name.startswith("ahrs") and "heading" in self.name else set()

    @property
    def size(self) -> float:
        """By how many seconds a clock is late on average, or by which part a scale is off; 0 of other mistakes."""
        late, scale = re.search(r"(\d+) s (late|early)", self.name), re.search(r"scale ([\d.]+)", self.name)
        if late or scale:
            return float(late[1]) if late else abs(float(scale[1]) - 1) if scale else 0.0
        return 2.0 if "fast" in self.name else 0.5 if "times of" in self.name else 0.0


def change(table: str, columns: list[str], function: Callable[[Array], Any]) -> Change:
    """Another number (n, k) in the cells of some columns."""

    def spoil(survey: Survey) -> None:
        log = survey.logs[table]
        new = function(np.column_stack([log[name] for name in columns]).astype(float))
        log.update({name: new[:, k] for k, name in enumerate(columns)})

    return spoil


def on(table: str) -> Callable[[str, list[str], Callable[[Array], Any], tuple[str, ...]], Mistake]:
    """Mistakes in columns of a table, from a name, the columns, what becomes of them, and patterns of the cause."""
    return lambda name, columns, function, right: Mistake(f"{table}: {name}", change(table, columns, function), right)


def some(table: str, columns: list[str], rows: slice | float, value: float, spread: float = 0.0) -> Change:
    """A value in some rows, or in a part of them, drawn; with a spread it is added."""

    def spoil(survey: Survey) -> None:
        rng, log = np.random.default_rng(7), survey.logs[table]
        n = len(log[TIME])
        chosen = np.arange(n)[rows] if isinstance(rows, slice) else rng.choice(n, max(1, int(rows * n)), replace=False)
        for name in columns:
            log[name] = log[name].copy()
            log[name][chosen] = log[name][chosen] + rng.normal(0, spread, len(chosen)) if spread else value

    return spoil


def repeated(table: str, columns: list[str], rows: slice) -> Change:
    """The first of some rows in all of them."""

    def spoil(survey: Survey) -> None:
        for name in columns:
            survey.logs[table][name][rows] = survey.logs[table][name][rows][0]

    return spoil


def rows(tables: tuple[str, ...], order: Callable[[int], Any]) -> Change:
    """Other rows, or in another order."""

    def spoil(survey: Survey) -> None:
        for table in tables or tuple(survey.logs):
            chosen = order(len(survey.logs[table][TIME]))
            survey.logs[table] = {name: column[chosen] for name, column in survey.logs[table].items()}

    return spoil


def mapped(table: str, **keys: Any) -> Change:
    """Other keys in a section of the mapping; None takes one away."""

    def spoil(survey: Survey) -> None:
        section = survey.mapping[table]
        section.update(keys)
        survey.mapping[table] = {key: value for key, value in section.items() if value is not None}

    return spoil


def grown(table: str, **factors: float) -> Change:
    """Constants of a section times a factor."""
    return lambda survey: survey.mapping[table].update({k: survey.mapping[table][k] * f for k, f in factors.items()})


def named(columns: list[str], *what: str) -> tuple[str, ...]:
    """Patterns: one of these columns, then what is wrong with it."""
    names = "|".join(NAMES[name] for name in columns)
    return tuple(rf"({names})\b.*({each})|({each}).*\b({names})\b" for each in what)


def unit(columns: list[str], units: str, factor: float) -> tuple[str, ...]:
    """Patterns of a wrong unit."""
    return named(columns, f'unit = "({units})"', f"(like|in) ({units})\\b", f"divide\\D+{factor:.3g}")
