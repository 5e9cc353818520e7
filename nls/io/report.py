"""What a reader found in a file: the report that comes with every graph."""

from __future__ import annotations

from dataclasses import dataclass, field

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
    ignored : lines that were not used, verbatim; `nls.save` writes them back.
    notes : remarks in words.
    reason : why the file was read in this format.
    warnings : those of the notes that deserve a `GraphWarning`, which `nls.load` gives.
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
