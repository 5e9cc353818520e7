"""What a reader found in a file: the report that comes with every graph."""

from __future__ import annotations

from dataclasses import dataclass, field

from factors.base import Factor
from models.algebra import Array

__all__ = ["LoadReport"]


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

    def warn(self, note: str) -> None:
        """A note that deserves a warning."""
        self.notes.append(note)
        self.warnings.append(note)

    def __str__(self) -> str:
        chosen = f" ({self.reason})" if self.reason else ""
        lines = [f"{self.path}: {self.format}{chosen}, {self.dimension}, convention {self.convention}"]
        lines += [f"  {tag:18s} {count:8d}" for tag, count in self.tags.items()]
        lines += [f"  {note}" for note in self.notes]
        return "\n".join(lines)
