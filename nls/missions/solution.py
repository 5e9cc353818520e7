"""The solution of a mission, or of several dives solved as one: its drift, its checks, and its accuracy.

    drift = |t_n - t_n,true| / distance,    distance = sum |t_k+1 - t_k|

of dead reckoning and of the solution, nothing aligned. Its files are in `nls.missions.files`, its words in
`nls.missions.summary`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Position, RangeAzimuth
from factors.keys import Kind, kinds
from models import SE3
from models.algebra import Array, Numbers, distance_along
from models.errors import GraphError, UnderconstrainedError
from models.finite import finite_or_none
from models.listing import some
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.io.report import LoadReport
from nls.io.trajectory import trajectory_text
from nls.metrics import TrajectoryError, ate, circles
from nls.missions import determination
from nls.missions.folder.dives import SHARED, Dive, DivesReport
from nls.missions.folder.folder import MissionReport
from nls.missions.sonar.elevation import Elevations, elevations
from nls.values import Values

if TYPE_CHECKING:
    from nls.linear import LinearSolver
    from nls.optimizers import Result

x, l = kinds("x", "l")


class Solution:
    """A solved mission of any kind: the numbers that are said of it and written.

    Parameters
    ----------
    graph : the measurements that are kept.
    dead : values as read: dead reckoning.
    result : of the optimization.
    report : of the mission.
    solver, gauge : of the covariances, as for `nls.Marginals`.
    """

    def __init__(
        self,
        graph: FactorGraph,
        dead: Values,
        result: Result,
        report: LoadReport,
        solver: LinearSolver | None = None,
        gauge: str = "first",
    ) -> None:
        self.graph, self.dead, self.result, self.report = graph, dead, result, report
        self.solver, self.gauge, self.values = solver, gauge, result.values

    @cached_property
    def covariances(self) -> tuple[Marginals | None, str]:
        """Covariances at the optimum; None and the note where there are none."""
        reason = "this is no optimum"
        if self.result.converged:
            try:
                return Marginals(self.graph, self.result.values, self.solver, self.gauge), ""
            except UnderconstrainedError as error:
                reason = str(error)
        return None, f"the files have no sigmas: {reason}"

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none, and a note says why."""
        marginals, note = self.covariances
        self.report.notes += [note] * (marginals is None)
        return marginals

    def tum(self) -> bytes:
        """trajectory.tum: the poses in the order of their times or numbers."""
        poses = Values.of([self.values.stack("x")])
        return trajectory_text("trajectory.tum", "tum", self.graph, poses, self.report)[0]


class SolvedMission(Solution):
    """A solved mission; parameters as for `Solution`."""

    report: MissionReport

    @cached_property
    def contacts(self) -> Sequence[RangeAzimuth]:
        """The factors of its contacts."""
        return [factor for factor in self.graph.factors if isinstance(factor, RangeAzimuth)]

    @property
    def mapped(self) -> bool:
        """Whether a sonar saw landmarks."""
        return bool(self.contacts) and self.report.sonar is not None

    @cached_property
    def tracks(self) -> dict[str, TrackErrors]:
        """Dead reckoning and solution against the truth; dead reckoning against the solution where there is none.

        None where there is no truth and nothing checks dead reckoning: the solution is dead reckoning then.
        """
        if "x" in self.report.truth.stacks:
            estimates, judge = {"dead reckoning": self.dead, "solution": self.values}, "truth"
        elif self.checks and "motion.csv" not in self.report.tags:
            estimates, judge = {"dead reckoning": self.dead}, "solution"
        else:
            return {}
        against = self.report.truth if judge == "truth" else self.values
        return {name: track_of(values, against, self.report, judge) for name, values in estimates.items()}

    @cached_property
    def checks(self) -> int:
        """Measured numbers that check the position of dead reckoning."""
        return determination.position_checks(self.graph, self.values, self.result.dof)

    @cached_property
    def unchecked(self) -> list[dict[str, Any]]:
        """Errors of whole tables that nothing shows; none where nothing checks dead reckoning, or at no optimum."""
        errors = [error for error in self.report.errors if error.hidden] if self.checks else []
        return [finite_or_none({"file": e.file, "quantity": e.quantity, "below": e.below}) for e in errors]

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none. Notes say why, and which variables have none."""
        marginals = super().marginals
        if marginals is None:
            return None
        mapped = self.report.sonar and l.name in self.values.stacks
        seen_once = determination.undetermined(marginals, l) if mapped else l[[]]
        if len(seen_once):
            self.report.notes.append(
                f"nothing measures the elevation of {some(list(seen_once))}: no sigmas there, all others are given. "
                "Add a contact from another place, or use the aperture of the sonar: --elevation prior"
            )
        kinds_of = [Kind(name) for name in self.values.stacks if name != l.name or not len(seen_once)]
        if free := [key for kind in kinds_of for key in determination.undetermined(marginals, kind)]:
            cause = marginals.underconstrained
            reason = "no measurement touches them" if cause is None else str(cause)
            self.report.notes.append(f"no sigmas of {some(free)}, all others are given: {reason}")
        return marginals

    @cached_property
    def elevations(self) -> Elevations:
        """Elevations of the landmarks at their first view, with sigmas where there are covariances."""
        return elevations(self.graph, self.values, self.marginals is not None, self.solver, self.gauge)

    @property
    def judge(self) -> str | None:
        """The reference of the tracks; None where nothing checks dead reckoning."""
        return next((track.against for track in self.tracks.values()), None)

    @cached_property
    def distance(self) -> float:
        """Distance travelled, m."""
        return [*self.tracks.values(), track_of(self.values, self.values, self.report, "solution")][0].distance

    def record(self) -> dict[str, Any]:
        """The mission in the report for programs."""
        distance = self.distance
        anchors = [repr(factor.keys[0]) for factor in self.graph.factors if isinstance(factor, Position)]
        out: dict[str, Any] = {
            "poses": len(self.values.stack("x")),
            "landmarks": len(self.values.stacks.get("l", ())),
            "contacts": sum(map(len, self.contacts)),
            "sonar": None if self.report.sonar is None else self.report.sonar.name,
            "anchor": ", ".join(self.report.world or anchors),
            "judge": self.judge,
            "distance_m": distance,
            "checks": self.checks,
            "unchecked": self.unchecked,
        }
        if not self.checks:
            end = determination.sigma_at_the_end(self.covariances[0], self.report)
            out["end_sigma_m"] = end
            out["end_sigma_percent"] = None if end is None or not distance > 0 else 100 * end / distance
        out |= drift_record(self.tracks)
        if self.contacts and "l" in self.report.truth.stacks:
            known = self.report.truth.stack("l").numbers
            landmarks = l[known[np.isin(known, self.values.stack("l").numbers)]]
            away = self.values[landmarks] - self.report.truth[landmarks]
            out["landmark_rmse_m"] = float(np.sqrt(np.square(away).sum(axis=1).mean())) if len(landmarks) else None
        if "elevations" in vars(self) and (known := np.isfinite(self.elevations.sigma)).any():  # with files
            sigma = np.degrees(self.elevations.sigma[known])
            out["elevation_sigma_deg"] = {"median": float(np.median(sigma)), "largest": float(sigma.max())}
            out["at_limit"] = int(self.elevations.pushed.sum())
            out["mirrored"] = int(self.elevations.mirrored.sum())
        if self.report.calibrations:
            out["calibrations"] = determination.determinations(self.values, self.report, self.covariances[0])
        return out


class SolvedDive(SolvedMission):
    """One dive in the solution of all: its own variables, with the numbers and covariances they have there.

    Parameters
    ----------
    whole : the solution of all dives.
    dive : the one.
    """

    contacts = ()

    def __init__(self, whole: SolvedDives, dive: Dive) -> None:
        report = replace(dive.report, truth=_own(whole.report.truth, dive))
        super().__init__(whole.graph, _own(whole.dead, dive), whole.result, report)
        self.whole, self.dive, self.values = whole, dive, _own(whole.values, dive)

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

    @property
    def tracks(self) -> dict[str, TrackErrors]:
        """None of all together: each dive has its own."""
        return {}

    @cached_property
    def dives(self) -> list[SolvedDive]:
        """The parts of the solution."""
        return [SolvedDive(self, dive) for dive in self.report.dives]

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


def _own(values: Values, dive: Dive) -> Values:
    """The values of this dive, and of what all share."""
    stacks = {}
    for kind, stack in values.stacks.items():
        mine = slice(None) if kind in SHARED else (stack.numbers >= dive.first) & (stack.numbers < dive.end)
        if len(numbers := stack.numbers[mine]):
            stacks[kind] = stack.manifold, stack.X[mine], numbers
    return Values(stacks)


@dataclass(frozen=True)
class TrackErrors:
    """A track beside its reference: the truth, or the solution where there is none.

    Attributes
    ----------
    against : ``truth`` or ``solution``.
    numbers : (n,) poses that both have, in the order of time.
    along : (n,) distance travelled up to every pose, along the path of the reference, m.
    error : (n,) distance between the two at every pose, m.
    ate : absolute trajectory error, nothing aligned.
    """

    against: str
    numbers: Numbers = field(repr=False)
    along: Array = field(repr=False)
    error: Array = field(repr=False)
    ate: TrajectoryError

    @property
    def distance(self) -> float:
        """Distance travelled, m."""
        return float(self.along[-1])

    @property
    def end(self) -> float:
        """Error at the last pose, m."""
        return float(self.error[-1])

    @property
    def drift(self) -> float:
        """Error at the last pose over the distance, a fraction; nan where nothing moved."""
        return self.end / self.distance if self.distance > 0 else float("nan")


def track_of(estimate: Values, judge: Values, report: MissionReport, against: str) -> TrackErrors:
    """The poses of an estimate beside those of a reference.

    Parameters
    ----------
    estimate, judge : poses ``x``; those that both have are compared, in the order of their times or numbers.
    report : of the mission: the times.
    against : the name of the reference, for the reader.

    Raises
    ------
    GraphError
        No pose is in both.
    """
    stack, known = estimate.stack("x"), judge.stack("x").numbers
    times = report.vertex_times.get("x", stack.numbers)
    numbers = stack.numbers[np.argsort(times, kind="stable")]
    numbers = numbers[np.isin(numbers, known)]
    if not len(numbers):
        raise GraphError(f"the {against} has none of the poses of the mission")
    P, Q = estimate[x[numbers]], judge[x[numbers]]
    error = ate(P, Q)
    return TrackErrors(against, numbers, distance_along(SE3.position(Q)), error.distances, error)


def drift_record(tracks: Mapping[str, TrackErrors]) -> dict[str, Any]:
    """Tracks in the report for programs, by their name."""
    return {
        name.replace(" ", "_"): {
            "drift_percent": 100 * track.drift,
            "end_error_m": track.end,
            "ate_rmse_m": track.ate.rmse,
            "ate_alignment": track.ate.align,
            **circles(track.ate.errors),
        }
        for name, track in tracks.items()
    }
