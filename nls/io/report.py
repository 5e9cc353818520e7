"""The report of a reader on a file, which comes with every graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np

from factors.base import Factor
from factors.noise import Noise
from models.algebra import Array, Index, Mask, Numbers
from models.visible import visible


class Source(NamedTuple):
    """The file and the lines that the measurements of one factor were read from.

    Attributes
    ----------
    path : the file; the folder of a mission where the measurement has no file.
    lines : (n,) the line of each measurement, counted from 1: the first where it has several, 0 where it has none.
    """

    path: str
    lines: Index


class Statement(NamedTuple):
    """The numbers of the lines that one factor was read from, which writing gives back as they were.

    Attributes
    ----------
    noise : of the factor.
    tag, convention : how the lines were read.
    z : (n, size) the measured elements they became.
    numbers : (n, columns) the numbers after the ids.
    parameters : (n, k) ids of parameters; offsets : (n, k, size) their values.
    """

    noise: Noise
    tag: bytes
    convention: str
    z: Array
    numbers: Array
    parameters: Numbers
    offsets: Array

    def numbers_of(self, factor: Factor, tag: bytes) -> Array | None:
        """The numbers of the lines of this factor, where they still say what it says."""
        same = (self.tag, self.convention) == (tag, factor.convention)
        return self.numbers if same and np.array_equal(self.z, factor.z) else None

    def only(self, mask: Mask, noise: Noise) -> Statement:
        """The numbers of some of the lines, and the noise of their factor."""
        some = {name: getattr(self, name)[mask] for name in ("z", "numbers", "parameters", "offsets")}
        return self._replace(noise=noise, **some)


@dataclass
class LoadReport:
    """Counts, choices and remarks of one read file; ``print(report)`` shows them.

    Attributes
    ----------
    path, format, dimension : what was read; the format is the dialect of a graph text file.
    convention : the residual of pose measurements, see `factors.conventions`.
    tags : lines per tag.
    vertices_given : False when the file has no vertices and the start was chained from the edges.
    ignored : lines that were not used, verbatim; `nls.save` writes them back to a file of the same format.
    notes : remarks in words.
    reason : why the file was read in this format.
    warnings : those of the notes that deserve a `GraphWarning`, which `nls.load` gives.
    vertex_times : (n,) per kind of pose, s, in the order of `Values`; none where the file has no times.
    factor_times : pairs of a factor and its times (n,), s.
    statements : the numbers of lines whose matrix is about angles or that name parameters; `nls.save` writes them to a
        file of the same format where a factor still has the noise and the measurements that were read from them.
    gtsam_kinds : kinds whose ids are keys of GTSAM in the file; `nls.save` writes them as such.
    sources : file and lines per factor, in the order of the factors of the graph as read; see `place`.

    Examples
    --------
    >>> import io, nls.io
    >>> file = io.BytesIO(b"# two steps\\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\\n")
    >>> graph, values, report = nls.io.load_stream(file, "steps.g2o")
    >>> report.sources[0].lines.tolist(), graph.factors[0].describe(1), report.place(0, 1)
    ([2, 3], 'Between(x1, x2)', 'steps.g2o:3')
    """

    path: str
    format: str
    dimension: str
    convention: str
    tags: dict[str, int] = field(default_factory=dict)
    vertices_given: bool = True
    ignored: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    reason: str = ""
    warnings: list[str] = field(default_factory=list)
    vertex_times: dict[str, Array] = field(default_factory=dict, compare=False, repr=False)
    factor_times: list[tuple[Factor, Array]] = field(default_factory=list, compare=False, repr=False)
    statements: list[Statement] = field(default_factory=list, compare=False, repr=False)
    gtsam_kinds: tuple[str, ...] = ()
    sources: list[Source] = field(default_factory=list, compare=False, repr=False)

    def place(self, factor: int, measurement: int) -> str:
        """File and line of a measurement such as ``survey.g2o:17``; the path alone where the measurement has no line.

        Parameters
        ----------
        factor : number of the factor in the graph as read, counted from 0; factors added later have no source.
        measurement : number of the measurement in its factor, counted from 0.
        """
        source = self.sources[factor]
        line = source.lines[measurement]
        return f"{source.path}:{line}" if line else source.path

    @property
    def has_lines(self) -> bool:
        """Whether a measurement has a line; those of a native file have none."""
        return any(source.lines.any() for source in self.sources)

    @property
    def assumed(self) -> list[int]:
        """Numbers of the factors that no line says, such as the anchor of a mission without one."""
        return [k for k, source in enumerate(self.sources) if not source.lines.any()] if self.has_lines else []

    @property
    def counts(self) -> dict[str, int]:
        """How much there is besides the graph, by name."""
        return {}

    def of_parts(self, factors: Sequence[Factor], parts: Sequence[tuple[int, Mask, Factor]]) -> Self:
        """The report of a graph of parts of these factors: the times and lines of their measurements; the same notes.

        Parameters
        ----------
        factors : as read, of this report.
        parts : number of the factor, which of its measurements (n,), and the factor of those.
        """
        times = {id(factor): times for factor, times in self.factor_times}
        known = {id(statement.noise): statement for statement in self.statements}
        return replace(
            self,
            factor_times=[(new, times[id(factors[k])][mask]) for k, mask, new in parts if id(factors[k]) in times],
            statements=[s.only(mask, new.noise) for k, mask, new in parts if (s := known.get(id(factors[k].noise)))],
            sources=[Source(self.sources[k].path, self.sources[k].lines[mask]) for k, mask, _ in parts],
        )

    def warn(self, note: str) -> None:
        """A note that deserves a warning."""
        self.notes.append(note)
        self.warnings.append(note)

    def __str__(self) -> str:
        chosen = f" ({self.reason})" if self.reason else ""
        lines = [f"{self.path}: {self.format}{chosen}, {self.dimension}, convention {self.convention}"]
        lines += [f"  {tag:18s} {count:8d}" for tag, count in self.tags.items()]
        lines += [f"  {note}" for note in self.notes]
        return visible("\n".join(lines))
