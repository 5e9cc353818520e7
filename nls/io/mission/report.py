"""What a mission folder holds besides its graph: the report that comes with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from models.algebra import Array
from models.geodesy import LocalPlane
from nls.io.report import LoadReport
from nls.values import Values

if TYPE_CHECKING:
    from models.sensors import ImagingSonar

__all__ = ["MissionReport"]


@dataclass
class MissionReport(LoadReport):
    """The report of a mission folder; `vertex_times` has the times of its poses where poses.csv gives them.

    Attributes
    ----------
    truth : the true poses ``x`` and landmarks ``l``, those of the files; no stacks where there is no truth.
    sonar : the sonar its contacts were seen with; None without contacts.
    offset : (7,) its mounting, the pose of the sonar on the vehicle, SE3.
    world : the files that say where in the world the track is, instead of an anchor; empty where there is an anchor.
    plane : where x = y = 0 is on the Earth, with x north and y east; None where no file says it.
    calibrations : value and standard deviation of the calibrations that are variables by name, before the measurements.
    """

    truth: Values = field(default_factory=Values)
    sonar: ImagingSonar | None = None
    offset: Array | None = field(default=None, compare=False)
    world: list[str] = field(default_factory=list)
    plane: LocalPlane | None = None
    calibrations: dict[str, tuple[float, float]] = field(default_factory=dict)
