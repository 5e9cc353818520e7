"""``nls solve DIVE DIVE ...``: what is said of each of several dives that were solved as one, and its files."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from nls.cli.job import Content
from nls.cli.solved_mission import SolvedMission, drift_record
from nls.missions.folder.dives import SHARED, Dive, DivesReport
from nls.values import Values

if TYPE_CHECKING:
    from nls.covariance import Marginals

__all__ = ["SolvedDive", "SolvedDives"]

OF_ALL = ("map.csv", "beacons.csv", "map.ply", "landmarks.png")  # files of the map, which the dives share
OF_EACH = (
    *("trajectory.tum", "trajectory.csv", "calibration.csv", "track.geojson", "track.kml", "track.png"),
    *("map.ply", "depth.asc"),  # with the bottom below the track
)


class SolvedDive(SolvedMission):
    """One dive in the solution of all: its own variables, with the numbers and covariances they have there.

    Parameters
    ----------
    whole : the solution of all dives.
    dive : the one.
    """

    def __init__(self, whole: SolvedDives, dive: Dive) -> None:
        super().__init__(whole.job)
        self.whole, self.dive, self.contacts = whole, dive, []
        self.dead, self.values = _own(whole.dead, dive), _own(whole.values, dive)
        self.report = replace(dive.report, truth=_own(whole.report.truth, dive))

    @property
    def checks(self) -> int:
        """Measured numbers that check the position of dead reckoning, in all dives together."""
        return self.whole.checks

    @property
    def covariances(self) -> tuple[Marginals | None, str]:
        """Covariances of all dives."""
        return self.whole.covariances


class SolvedDives(SolvedMission):
    """Several dives, solved as one."""

    report: DivesReport

    @cached_property
    def dives(self) -> list[SolvedDive]:
        """The parts of the solution."""
        return [SolvedDive(self, dive) for dive in self.report.dives]

    @cached_property
    def tracks(self) -> dict[str, Any]:
        """None of all together: each dive has its own."""
        return {}

    def record(self) -> dict[str, Any]:
        """The dives in the report for programs."""
        out = super().record()
        out["distance_m"] = sum(dive.distance for dive in self.dives)
        out["dives"] = [
            {"name": d.dive.name, "first": d.dive.first, "poses": len(d.values.stack("x")), "distance_m": d.distance}
            | {"judge": d.judge}
            | drift_record(d.tracks)
            for d in self.dives
        ]
        return out

    def files(self) -> dict[str, Content]:
        """Those of the map in the folder, those of each track in a folder with the name of its dive."""
        out = {name: make for name, make in super().files().items() if name in OF_ALL}
        for part in self.dives:
            own = part.files()
            out |= {f"{part.dive.name}/{name}": own[name] for name in own if name in OF_EACH}
        return out


def _own(values: Values, dive: Dive) -> Values:
    """What is of this dive, or of all."""
    stacks = {}
    for kind, stack in values.stacks.items():
        mine = slice(None) if kind in SHARED else (stack.numbers >= dive.first) & (stack.numbers < dive.end)
        if len(numbers := stack.numbers[mine]):
            stacks[kind] = stack.manifold, stack.X[mine], numbers
    return Values(stacks)
