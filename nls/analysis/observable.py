"""The knowledge of one variable, in words: sigmas by component, free directions, the weakest direction."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.keys import Keys
from models.algebra import Array, Mask
from models.finite import finite_or_none
from models.html_table import html_table

FREE = 1e-7  # |E n| of a free direction, 1 if all else were known: 5e-14 at the worst seen, 3e-12 with differences
HEADS = ("", "one sigma", "all else known", "compared")

Row = tuple[str, str, str, str]


@dataclass(frozen=True)
class Observability:
    """The information of a data set about one variable, everything else being estimated too. ``print`` it.

    Arrays are in the tangent space of the variable (of a pose: its own axes), in the units of its space.

    Attributes
    ----------
    key : the variable.
    components, units : (d) names, and the unit of each, empty where it has none.
    covariance : (d, d) Cramer-Rao bound on what is determined; what is free takes no part in it.
    undetermined : (d,) components a free direction moves.
    free : (k, d) directions in which it can move and no measurement changes.
    with_free : (k) what else moves with each: ``"x, y, z of x; x, y, z of l"``.
    weak : (d - k, d) the other directions, weakest first, as steps of one standard deviation.
    known : (d,) information of each component if all else were known.
    weights : (d,) what a unit of each component counts where directions are compared.
    length : m that a rotation of 1 rad counts there.
    gauge : what holds the rest of the graph.
    """

    key: Keys
    components: tuple[str, ...]
    units: tuple[str, ...]
    covariance: Array
    undetermined: Mask
    free: Array
    with_free: tuple[str, ...]
    weak: Array
    known: Array
    weights: Array
    length: float
    gauge: str

    @property
    def rank(self) -> int:
        """How many directions are determined."""
        return len(self.weak)

    @property
    def sigma(self) -> Array:
        """Standard deviation of every component (d,); inf where it is not determined."""
        return np.where(self.undetermined, np.inf, np.sqrt(np.diagonal(self.covariance)))

    @property
    def sigma_known(self) -> Array:
        """Sigmas (d,) if all else, the other components too, were known; inf where no measurement reacts."""
        informed = np.sqrt(self.known) > FREE * self.weights
        return np.where(informed, 1 / np.sqrt(np.where(informed, self.known, 1.0)), np.inf)

    @property
    def correlation(self) -> Array:
        """Correlations (d, d); nan in the rows and columns of what is not determined."""
        sigma = np.where(self.undetermined, np.nan, self.sigma)
        return np.asarray(self.covariance / np.outer(sigma, sigma))

    @property
    def weakest(self) -> int:
        """The component of the largest sigma, 1 rad counting `length` meters; the first undetermined one, if any."""
        return int(np.argmax(self.sigma * self.weights))

    @property
    def compared(self) -> Array:
        """Every sigma (d,) as a multiple of the smallest one of its unit."""
        units = np.array(self._comparable)
        best = np.array([self.sigma[units == unit].min() for unit in units])
        return np.where(np.isinf(self.sigma), np.inf, self.sigma / np.where(np.isinf(best), 1.0, best))

    def direction(self, step: npt.ArrayLike) -> str:
        """A step (d,) by its components: ``"y 0.012 m, pitch -0.42 deg"``; what hardly takes part is left out."""
        step = np.asarray(step, dtype=float)
        size = np.abs(step * self.weights)
        indices = np.flatnonzero(size >= 0.2 * size.max())
        return ", ".join(f"{self.components[i]} {in_unit(step[i], self.units[i])}" for i in indices)

    @property
    def _comparable(self) -> list[str]:
        """Labels (d) that comparable components share: their unit, or where they have none their name."""
        return [unit or name for name, unit in zip(self.components, self.units, strict=True)]

    def _head(self) -> str:
        return f"{self.key!r}: {self.rank} of {len(self.components)} directions determined; {self.gauge}"

    def _rows(self) -> list[Row]:
        """Component, sigma, sigma if all else were known, compared with the best of its unit."""
        rows: list[Row] = []
        alike, ratios = self._comparable, self.compared
        best = {alike[i]: self.components[i] for i in np.flatnonzero(ratios == 1.0)}
        for i, (c, unit) in enumerate(zip(self.components, self.units, strict=True)):
            comparison = f"{ratios[i]:.1f} x {best[alike[i]]}" if 1.0 < ratios[i] < np.inf else ""
            sigma, known = shown(self.sigma[i], unit, "free"), shown(self.sigma_known[i], unit, "-")
            rows.append((c, sigma, known, comparison))
        return rows

    def _notes(self) -> list[str]:
        """Lines on free, weakest and correlated directions."""
        notes = []
        for n, companions in zip(self.free, self.with_free, strict=True):
            size = np.abs(n * self.weights)
            named = ", ".join(self.components[i] for i in np.flatnonzero(size >= 0.02 * size.max()))
            notes.append(f"free: {named}" + (f" (together with {companions})" if companions else ""))
        if self.rank > 1:
            notes.append(f"weakest direction, one sigma: {self.direction(self.weak[0])}")
        r = self.correlation
        for i, j in zip(*np.triu_indices(len(r), 1), strict=True):
            if abs(r[i, j]) >= 0.9:
                notes.append(f"correlated: {self.components[i]} and {self.components[j]}, {r[i, j]:.3f}")
        return notes

    def __str__(self) -> str:
        return "\n".join([self._head(), *columns([HEADS, *self._rows()]), *self._notes()])

    def _repr_html_(self) -> str:
        return html_table(self._head(), HEADS, self._rows(), self._notes())

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON knows it: None for a sigma or correlation that does not exist."""
        return {
            "key": repr(self.key),
            "components": list(self.components),
            "units": list(self.units),
            "rank": self.rank,
            "gauge": self.gauge,
            "length": self.length,
            "sigma": finite_or_none(self.sigma.tolist()),
            "sigma_known": finite_or_none(self.sigma_known.tolist()),
            "compared": finite_or_none(self.compared.tolist()),
            "weakest": self.components[self.weakest],
            "free": [
                {"step": n.tolist(), "with": companions}
                for n, companions in zip(self.free, self.with_free, strict=True)
            ],
            "weak": self.weak.tolist(),
            "correlation": finite_or_none(self.correlation.tolist()),
        }


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of a table as lines: the first column to the left, the others to the right."""
    first, *widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(["", name.ljust(first), *map(str.rjust, cells, widths)]).rstrip() for name, *cells in rows]


def shown(number: float, unit: str, infinite: str) -> str:
    """A number with three digits and a unit, as `in_unit`; a word where it is infinite."""
    return infinite if np.isinf(number) else in_unit(number, unit)


def in_unit(number: float, unit: str) -> str:
    """A number with three digits and a unit; radians in degrees.

    Examples
    --------
    >>> in_unit(0.1, "rad"), in_unit(35.0, "g/kg"), in_unit(0.5, "")
    ('5.73 deg', '35 g/kg', '0.5')
    """
    return f"{degrees(number):.3g} deg" if unit == "rad" else f"{number:.3g} {unit}".rstrip()
