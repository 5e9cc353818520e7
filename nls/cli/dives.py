"""``nls solve DIVE DIVE ...``: what is said of each of several dives that were solved as one, and its files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nls.cli.mission import Solved, drift_record
from nls.cli.mission_files import MissionFiles
from nls.io.mission import MissionReport
from nls.io.mission.dives import SHARED, Dive, DivesReport
from nls.values import Values

if TYPE_CHECKING:
    from nls.cli.job import Job
    from nls.covariance import Marginals

__all__ = ["SolvedDive", "SolvedDives", "outputs_of", "solution_of"]

OF_ALL = ("map.csv", "beacons.csv", "map.ply", "landmarks.png")  # files of the map, which the dives share
OF_EACH = (
    *("trajectory.tum", "trajectory.csv", "calibration.csv", "track.geojson", "track.kml", "track.png"),
    *("map.ply", "depth.asc"),  # with the bottom below the track
)


class SolvedDive(Solved):
    """One dive in the solution of all: its own variables, with the numbers and covariances they have there.

    Parameters
    ----------
    whole : the solution of all dives.
    dive : the one.
    """

    def __init__(self, whole: SolvedDives, dive: Dive) -> None:
        truth = _own(whole.report.truth, dive)
        report = replace(dive.report, truth=truth)
        super().__init__(
            whole.graph, _own(whole.dead, dive), whole.result, report, whole.solver, whole.gauge, whole.projection
        )
        self.whole, self.dive, self.values, self.contacts = whole, dive, _own(whole.values, dive), []
        self.doubts = whole.doubts

    @property
    def checks(self) -> int:
        """Measured numbers that check the position of dead reckoning, in all dives together."""
        return self.whole.checks

    @property
    def marginals(self) -> Marginals | None:
        """Covariances of all dives."""
        return self.whole.marginals


class SolvedDives(Solved):
    """Several dives, solved as one; parameters as for `Solved`."""

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


def solution_of(job: Job) -> Solved:
    """The solution of a mission, or of several dives in one graph."""
    report = job.report
    assert isinstance(report, MissionReport)
    kind = SolvedDives if isinstance(report, DivesReport) else Solved
    return kind(job.graph, job.values, job.result, report, job.solver, job.options.gauge, job.projection)


def outputs_of(solved: Solved, folder: str) -> list[tuple[Callable[[str], None], str]]:
    """Files and folders: of several dives the map in the folder, each track in a folder with the name of its dive."""
    files = MissionFiles(solved).outputs(folder)
    if not isinstance(solved, SolvedDives):
        return files
    out = [(write, path) for write, path in files if Path(path).name in OF_ALL]
    for part in solved.dives:
        outputs = MissionFiles(part).outputs(str(Path(folder, part.dive.name)))
        out += [(_within(write), path) for write, path in outputs if Path(path).name in OF_EACH]
    return out


def _own(values: Values, dive: Dive) -> Values:
    """What is of this dive, or of all."""
    stacks = {}
    for kind, stack in values.stacks.items():
        mine = slice(None) if kind in SHARED else (stack.numbers >= dive.first) & (stack.numbers < dive.end)
        if len(numbers := stack.numbers[mine]):
            stacks[kind] = stack.manifold, stack.X[mine], numbers
    return Values(stacks)


def _within(write: Callable[[str], None]) -> Callable[[str], None]:
    """Write a file in a folder that is made where it is missing."""

    def written(path: str) -> None:
        Path(path).parent.mkdir(exist_ok=True)
        write(path)

    return written
