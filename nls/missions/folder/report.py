"""The report of a mission folder: its contents besides the graph."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from factors.base import Factor
from models.algebra import Array, Index, Mask
from models.geodesy import LocalPlane
from nls.io.report import LoadReport
from nls.values import Values

if TYPE_CHECKING:
    from factors import RangeAzimuth
    from models.sensors import ImagingSonar
    from nls.missions.checks.findings import Explained, Implausible, TableError
    from nls.missions.folder.table import Table


@dataclass(frozen=True)
class Unnamed:
    """Contacts of a mission that names no landmarks; they are in no factor until `nls.missions.associated` finds them.

    Attributes
    ----------
    contacts : n of them, within the track; each has its own number for a target.
    table, rows : contacts.csv, and the row (n,) of each.
    elevation : what is done about the elevation once their landmarks are known, see `factors.sonar_factors`.
    """

    contacts: RangeAzimuth
    table: Table
    rows: Index
    elevation: str

    def __len__(self) -> int:
        return len(self.contacts)

    def note(self, path: str) -> str:
        """The remark of the report of a mission folder on contacts that are not in its graph."""
        return (
            f"contacts.csv names no landmarks: none of its {len(self):,} contacts is in the graph, nor in a file or "
            f"picture of it. nls solve {shlex.quote(path)} --write-graph FILE finds their landmarks and writes the "
            "graph with them; in Python nls.missions.associated(graph, values, report)"
        )


@dataclass
class MissionReport(LoadReport):
    """The report of a mission folder; `vertex_times` has the times of its poses where poses.csv gives them.

    Attributes
    ----------
    truth : the true poses ``x`` and landmarks ``l``, those of the files; no stacks where there is no truth.
    sonar : the sonar its contacts were seen with; None without contacts.
    offset : (7,) its mounting, the pose of the sonar on the vehicle, SE3.
    unmeasured : components of a pose, such as ``yaw``, that nothing measures: held at 0, their cells are empty.
    compass : whether a sensor measures the heading in the world.
    elsewhere : dive_closures.csv, whose rows need the poses of other dives; None without it.
    world : the files that say where in the world the track is, instead of an anchor; empty where there is an anchor.
    soundings : (n, 2) times and heights of the vehicle over the bottom, s and m; None where its log has none.
    findings : what is implausible in the tables, each also a warning.
    explained : what explains chi2 where it was implausible; None where it was not asked.
    errors : of whole tables at the optimum, as `nls.missions.checks.table_errors` has them.
    plane : where x = y = 0 is on the Earth, with x north and y east; None where no file says it.
    unnamed : the contacts that name no landmark, and so are in no factor; None where there are none.
    dive_of : the name of the dive that each factor is of; empty for one mission.
    calibrations : value and standard deviation of the calibrations that are variables by name, before the measurements.
    """

    truth: Values = field(default_factory=Values)
    sonar: ImagingSonar | None = None
    offset: Array | None = field(default=None, compare=False)
    unmeasured: tuple[str, ...] = ()
    compass: bool = False
    elsewhere: Table | None = field(default=None, compare=False, repr=False)
    world: list[str] = field(default_factory=list)
    soundings: Array | None = field(default=None, compare=False)
    plane: LocalPlane | None = None
    calibrations: dict[str, tuple[float, float]] = field(default_factory=dict)
    findings: list[Implausible] = field(default_factory=list)
    explained: Explained | None = None
    errors: list[TableError] = field(default_factory=list)
    unnamed: Unnamed | None = field(default=None, compare=False, repr=False)
    dive_of: list[str] = field(default_factory=list, repr=False)

    @property
    def counts(self) -> dict[str, int]:
        """The contacts that are not in the graph, where there are some."""
        return {} if self.unnamed is None else {"contacts_without_names": len(self.unnamed)}

    @property
    def tables(self) -> list[str]:
        """The file that each factor is from, such as ``fixes.csv``; of several dives with the name of the dive."""
        files = [Path(source.path).name for source in self.sources]
        return [f"{dive}/{file}" for dive, file in zip(self.dive_of, files, strict=True)] if self.dive_of else files

    def of_parts(self, factors: Sequence[Factor], parts: Sequence[tuple[int, Mask, Factor]]) -> Self:
        """The report of a graph of parts of these factors, as for `LoadReport`; with the dives that they are of."""
        dives = [self.dive_of[k] for k, _, _ in parts] if self.dive_of else []
        return replace(super().of_parts(factors, parts), dive_of=dives)

    @property
    def anchored(self) -> bool:
        """Whether a file places the mission in the world."""
        return bool(self.world) or "anchor.csv" in self.tags
