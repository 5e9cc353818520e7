"""The graph of a mission while its files are read one after the other: what each of them needs, and adds to."""

from __future__ import annotations

from dataclasses import dataclass, field

from factors.base import Factor
from nls.graph import FactorGraph
from nls.io.mission.calibration import Calibrations
from nls.io.mission.report import MissionReport
from nls.io.mission.table import Table
from nls.io.mission.timeline import Times
from nls.io.report import Source

__all__ = ["Assembly"]


@dataclass(frozen=True)
class Assembly:
    """The tables of a mission, and the graph that is made of them.

    Attributes
    ----------
    tables : by name.
    report : gets notes, and the lines of the factors.
    calibrations : of calibration.csv.
    times : of the rows of files, see `nls.io.mission.timeline`.
    graph : gets the factors.
    """

    tables: dict[str, Table]
    report: MissionReport
    calibrations: Calibrations
    times: Times
    graph: FactorGraph = field(default_factory=FactorGraph)

    def add(self, factor: Factor, source: Source) -> None:
        """Add a factor, with the lines that it was read from."""
        self.graph.add(factor)
        self.report.sources.append(source)
