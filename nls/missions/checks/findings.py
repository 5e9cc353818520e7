"""The result of a check: numbers, and where they stand; `words` makes sentences of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from models.findings import Numbered, Stated, register
from nls.explanation.findings import FindingKind


class Cause(StrEnum):
    """The probable cause of an implausible number."""

    UNIT = "unit"  # the number is `factor` times the one in the unit of the column
    SIGN = "sign"
    SWAPPED = "swapped"  # two columns are exchanged
    AXES = "axes"  # x ahead, y to port, z up
    EARTH = "earth"  # along north, east and down
    NORTH = "north"  # counted from east, counterclockwise
    CLOCK = "clock"  # late by `factor` seconds
    ZONE = "zone"  # so, and by as many as between two clocks that are right: hours, weeks, leap seconds
    DRIFT = "drift"  # fast by the part `factor`
    ARM = "arm"  # `factor` m too large
    SCALE = "scale"  # `factor` times too large
    INVERTED = "inverted"
    NONE = "none"  # the number `factor` stands for none
    ZEROS = "zeros"  # 0 in all columns does
    STUCK = "stuck"
    OUTLIERS = "outliers"
    SIGMA = "sigma"  # too small by `factor`
    FAR = "far"
    PRESSURE = "pressure"  # absolute, in a unit that is `factor` times smaller than a decibar
    STALE = "stale"  # repeated, of a vehicle that moves
    CALIBRATION = "calibration"  # the row of calibration.csv has `factor`
    KERNEL = "kernel"  # the part `factor` of the rows is to be ignored
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Reading:
    """A cause, of which file and column, with its factor, degrees or seconds; 1 where it has none.

    A clock that runs fast has an offset, s, to be added to its times after they are divided by 1 + factor.
    """

    cause: Cause
    file: str
    column: str
    factor: float = 1.0
    offset: float = 0.0

    @property
    def columns(self) -> list[str]:
        """Columns by name."""
        return self.column.split(", ")


@dataclass(frozen=True)
class Implausible(Numbered):
    """A number that measurements of a vehicle do not have.

    Attributes
    ----------
    check : name of the check.
    file, line, column : where the number stands; the first line that shows it, counted from 1.
    measured, limit : the number, and the limit it is beyond.
    unit : of both; empty for a ratio.
    readings : what explains it, the most probable first; several where the log does not distinguish them.
    lines : of all rows that show it, where these are to be left out.
    """

    check: str
    file: str
    line: int
    column: str
    measured: float
    limit: float
    unit: str
    readings: tuple[Reading, ...]
    lines: tuple[int, ...] = ()
    kind = FindingKind.IMPLAUSIBLE

    @classmethod
    def of(
        cls, check: str, measured: float, limit: float, unit: str, *readings: Reading, row: Any = 0, lines: Any = ()
    ) -> Implausible:
        """A finding about the file and column of its first reading, at a row, or all of some, of the table."""
        first, at = readings[0], tuple(map(int, lines))
        row = at[0] if at else int(row)
        return cls(check, first.file, row, first.columns[0], float(measured), float(limit), unit, readings, at)


@dataclass(frozen=True)
class Trial:
    """A reading that the solver has tried, with the chi2 that remains.

    Attributes
    ----------
    reading : a calibration, other columns, or a kernel whose column is the type of measurement.
    sigma : of the factor of a calibration; 0 of others.
    chi2, dof : of its optimum; under a kernel of the rows that this does not ignore.
    """

    reading: Reading
    sigma: float
    chi2: float
    dof: int


@dataclass(frozen=True)
class Explained(Numbered):
    """The words of the solver for an implausible chi2.

    Attributes
    ----------
    chi2, dof : of the mission as it is.
    trials : explanations, which the data do not distinguish, the least chi2 first. Empty where none was found.
    """

    chi2: float
    dof: int
    trials: tuple[Trial, ...]
    kind = FindingKind.IMPLAUSIBLE


@dataclass(frozen=True)
class TableError:
    """An error of all rows of a table.

    Attributes
    ----------
    file : of the table.
    quantity : ``heading``, ``heading drift``, ``turn``, ``depth`` (its zero and its scale), ``zero of the depth``,
        ``scale``, ``place``, ``clock``, ``drift`` or ``arm``.
    below : the size that would be seen, rad, m or s; infinite where none is, or nearly so.
    reading : the error as the measurements have it, also one that may be chance; None where they say nothing.
    sigma : of its factor.
    fall : of chi2 without it.
    evident : whether it is beyond chance and moves the track by more than its standard deviation.
    hidden : whether one that matters, and moves the track so, would not be evident.
    """

    file: str
    quantity: str
    below: float
    reading: Reading | None = None
    sigma: float = 0.0
    fall: float = 0.0
    evident: bool = False
    hidden: bool = False


class SetupKind(StrEnum):
    """A wrong setup, the identifier that programs get."""

    UNREPEATED = "unrepeated"
    MIRRORED = "mirrored"
    MOUNTING = "mounting"
    TURNED = "turned"
    TIME_OFFSET = "time_offset"
    SIGMAS_TOO_LARGE = "sigmas_too_large"
    SIGMAS_TOO_SMALL = "sigmas_too_small"


register("nls.missions.checks.words", FindingKind.IMPLAUSIBLE, *SetupKind)


@dataclass(frozen=True)
class SetupFinding(Stated):
    """A wrong setup.

    Attributes
    ----------
    kind : of it.
    numbers : by name, m, rad and s.

        - ``unrepeated``: `scans` that were matched with those just before them, and how many of these `fit`.
        - ``mirrored``: steps that turn and fit better as `given`, and `mirrored`.
        - ``mounting``: `component` x, y or yaw, its `value` and `sigma` from the assumed one, and the `mount` (3,) that
          follows.
        - ``turned``: `value` and `sigma` of the yaw that is missing if nothing drifts sideways, and `mount`.
        - ``time_offset``: `value`, by which the stamps of the scans are late, and `sigma`.
        - ``sigmas_too_large``, ``sigmas_too_small``: `measurements` steps, drifts or closures, `chi2`, `dof`, `scale`
          on the stated sigmas.
    """

    kind: SetupKind
    numbers: Mapping[str, Any]
