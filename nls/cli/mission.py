"""``nls solve DIR``: what the solution of a mission adds to the table, and the files it is written to."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Position, RangeAzimuth
from factors.keys import Keys, kinds
from models.errors import OptionError, UnderconstrainedError
from models.listing import some
from nls.io.dialects import SUFFIXES
from nls.io.mission import Elevations, MissionReport, Track, elevations, held_free, track_of

if TYPE_CHECKING:
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.io.mission.determination import Determination
    from nls.linear import LinearSolver
    from nls.optimizers import Result
    from nls.values import Values


x, l = kinds("x", "l")
FILES = ("trajectory.tum", "trajectory.csv", "map.csv", "track.png", "landmarks.png", "sonar.png")


def refuse_unwritable_folder(folder: str | None, mission: str, form: str | None) -> None:
    """Find out before the work that a folder cannot hold the solution of a mission; one that is not there is made.

    Raises
    ------
    OptionError
    """
    if form is not None:
        raise OptionError("--to", form, "nothing: the solution of a mission is a folder with files of their own")
    if folder is None:
        return
    if Path(folder).suffix in SUFFIXES and not os.path.isdir(folder):
        raise OptionError("output folder", folder, "a folder: the solution of a mission is several files")
    path = Path(folder)
    existing = next((p for p in (path, *path.absolute().parents) if os.path.exists(p)), path)
    if not folder or folder == "-" or not os.path.isdir(existing):
        raise OptionError("output folder", folder, "a folder, or the name of one to be made: the input is a mission")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OptionError("output folder", folder, "a folder you may write to")
    if os.path.exists(path) and os.path.samefile(path, mission):
        raise OptionError("output folder", folder, "another folder than that of the mission")


class Solved:
    """A solved mission: everything that is said of it and written.

    Parameters
    ----------
    graph, dead, result, report : the mission, its dead reckoning, its solution, and what its folder holds.
    solver, gauge : for the covariances.
    """

    def __init__(
        self,
        graph: FactorGraph,
        dead: Values,
        result: Result,
        report: MissionReport,
        solver: LinearSolver,
        gauge: str,
    ) -> None:
        self.graph, self.dead, self.result, self.report = graph, dead, result, report
        self.solver, self.gauge = solver, gauge
        self.values = result.values
        self.contacts = [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]

    @cached_property
    def tracks(self) -> dict[str, Track]:
        """Dead reckoning and solution against the truth; dead reckoning against the solution where there is none."""
        if "x" in self.report.truth.stacks:
            estimates, judge = {"dead reckoning": self.dead, "solution": self.values}, "truth"
        else:
            estimates, judge = {"dead reckoning": self.dead}, "solution"
        against = self.report.truth if judge == "truth" else self.values
        return {name: track_of(values, against, self.report, judge) for name, values in estimates.items()}

    @cached_property
    def determined(self) -> tuple[FactorGraph, Marginals | None, Keys]:
        """A graph that determines everything, its covariances at the optimum, and the landmarks it had to hold.

        Notes say which these are, and where there are no covariances (None), why.
        """
        graph, free = self.graph, l[[]]
        if not self.result.converged:
            self.report.notes.append("the files have no sigmas: this is no optimum")
            return graph, None, free
        try:
            return graph, self._marginals(graph), free
        except UnderconstrainedError as error:
            why = error
        if self.contacts:
            graph, free = held_free(graph, self.values)
        try:
            marginals = self._marginals(graph) if len(free) else None
        except UnderconstrainedError as error:
            marginals, why = None, error
        if marginals is None:
            self.report.notes.append(f"the files have no sigmas: {why}")
            return self.graph, None, l[[]]
        self.report.notes.append(
            f"nothing measures the elevation of {some(list(free))}: no sigmas there, all others are given; a contact "
            "from elsewhere measures it, and --elevation prior takes the aperture of the sonar for it"
        )
        return graph, marginals, free

    def _marginals(self, graph: FactorGraph) -> Marginals:
        """Covariances of all variables; UnderconstrainedError where one has none."""
        from nls.covariance import Marginals

        marginals = Marginals(graph, self.values, self.solver, self.gauge)
        if marginals.underconstrained is not None:
            raise marginals.underconstrained
        return marginals

    @property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none."""
        return self.determined[1]

    @property
    def free(self) -> Keys:
        """Landmarks whose elevation nothing measures."""
        return self.determined[2]

    @cached_property
    def elevations(self) -> Elevations:
        """Elevations of the landmarks at their first view, with sigmas where there are covariances."""
        graph, marginals, free = self.determined
        return elevations(graph, self.values, marginals is not None, self.solver, self.gauge, free)

    @cached_property
    def calibrations(self) -> list[Determination]:
        """What the measurements say of the calibrations."""
        from nls.io.mission.determination import determinations

        return determinations(
            self.graph, self.values, self.report, self.solver, self.gauge, bool(self.result.converged)
        )

    def outputs(self, folder: str) -> list[tuple[Callable[[str], None], str]]:
        """What to write where: functions that take the name of the file, and the names."""
        writers = [self._tum, self._trajectory, self._map, self._track, self._landmarks, self._sonar]
        has_elevations = self.contacts and self.report.sonar is not None
        named = [
            (write, name)
            for write, name in zip(writers, FILES, strict=True)
            if has_elevations or name.startswith("tra")
        ]
        if "b" in self.values.stacks:
            named.append((self._beacons, "beacons.csv"))
        if "calibration.csv" in self.report.tags:
            named.append((self._calibration, "calibration.csv"))
        return [(write, str(Path(folder, name))) for write, name in named]

    def _tum(self, path: str) -> None:
        from nls.io.trajectory import write_tum

        stack = self.values.stack("x")
        times = self.report.vertex_times.get("x", stack.numbers.astype(float))
        order = np.argsort(times, kind="stable")
        write_tum(path, times[order], np.asarray(stack.X)[order])

    def _trajectory(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import trajectory_text

        write_bytes(path, trajectory_text(self.values, self.marginals))

    def _map(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import map_text

        write_bytes(path, map_text(self.values, self.marginals, self.elevations))

    def _beacons(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import beacons_text

        write_bytes(path, beacons_text(self.values, self.marginals))

    def _calibration(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import calibration_text

        write_bytes(path, calibration_text(self.values, self.marginals))

    def _track(self, path: str) -> None:
        from nls.plot.mission import track
        from nls.plot.picture import write_picture

        write_picture(path, track(self.values, self.dead, self.report.truth, self.marginals, self.tracks))

    def _landmarks(self, path: str) -> None:
        from nls.plot.mission import landmark_map
        from nls.plot.picture import write_picture

        assert self.report.sonar is not None
        figure = landmark_map(self.values, self.elevations, self.report.truth, self.report.sonar.aperture)
        write_picture(path, figure)

    def _sonar(self, path: str) -> None:
        """The fan of the pose with the most contacts."""
        from nls.plot.picture import write_picture
        from nls.plot.sonar import arcs

        poses, count = np.unique(self.contacts[0].keys[0].numbers, return_counts=True)
        pose = x[int(poses[np.argmax(count)])]
        assert self.report.sonar is not None
        figure = arcs(self.contacts[0], self.values, pose, self.report.sonar)
        figure.axes[0].set_title(f"{self.report.sonar.name}: what it saw from {pose!r}", fontsize=9)
        write_picture(path, figure)

    def record(self) -> dict[str, Any]:
        """What the report for programs says of the mission."""
        first = next(iter(self.tracks.values()))
        anchors = [repr(factor.keys[0]) for factor in self.graph.factors if isinstance(factor, Position)]
        out: dict[str, Any] = {
            "poses": len(self.values.stack("x")),
            "landmarks": len(self.values.stacks.get("l", ())),
            "contacts": sum(map(len, self.contacts)),
            "sonar": None if self.report.sonar is None else self.report.sonar.name,
            "anchor": ", ".join(self.report.world or anchors),
            "judge": first.against,
            "distance_m": first.distance,
        }
        for name, track in self.tracks.items():
            out[name.replace(" ", "_")] = {
                "drift_percent": 100 * track.drift,
                "end_error_m": track.end,
                "ate_rmse_m": track.ate.rmse,
                "ate_alignment": track.ate.align,
            }
        if self.contacts and "l" in self.report.truth.stacks:
            known = self.report.truth.stack("l").numbers
            landmarks = l[known[np.isin(known, self.values.stack("l").numbers)]]
            away = self.values[landmarks] - self.report.truth[landmarks]
            out["landmark_rmse_m"] = float(np.sqrt(np.square(away).sum(axis=1).mean())) if len(landmarks) else None
        if "elevations" in vars(self) and (known := np.isfinite(self.elevations.sigma)).any():  # with files
            sigma = np.degrees(self.elevations.sigma[known])
            out["elevation_sigma_deg"] = {"median": float(np.median(sigma)), "largest": float(sigma.max())}
            out["at_limit"] = int(self.elevations.pushed.sum())
        if self.report.calibrations:
            out["calibrations"] = [
                {
                    **{"name": c.name, "value": c.value, "sigma": c.sigma, "sigma_before": c.sigma_before},
                    **{"share": c.share, "determined": c.determined},
                }
                for c in self.calibrations
            ]
        return out


def lines(mission: dict[str, Any]) -> list[str]:
    """The lines of the table that say what a mission's solution is worth."""
    judge = "the truth" if mission["judge"] == "truth" else "the solution, as there is no truth.csv"
    named = {key.replace("_", " "): mission[key] for key in ("dead_reckoning", "solution") if key in mission}
    drift = ", ".join(
        f"{name} {_percent(s['drift_percent'])} ({_short(s['end_error_m'])} m)" for name, s in named.items()
    )
    ate = ", ".join(f"{name} {_short(s['ate_rmse_m'])} m" for name, s in named.items())
    out = [
        f"mission     {mission['poses']} poses over {mission['distance_m']:.4g} m, {mission['landmarks']} landmarks, "
        f"{mission['contacts']} contacts" + (f" of a {mission['sonar']}" if mission["sonar"] else ""),
        f"drift       {drift} of the distance at the end, against {judge}",
        f"ATE         {ate} rmse (no alignment: {_held(mission['anchor'])})",
    ]
    if mission.get("landmark_rmse_m") is not None:
        out.append(f"landmarks   {mission['landmark_rmse_m']:.3g} m rmse, against landmarks.csv")
    if "elevation_sigma_deg" in mission:
        s = mission["elevation_sigma_deg"]
        edge = f"; {mission['at_limit']} landmarks at the edge of the aperture" if mission["at_limit"] else ""
        out.append(
            f"elevation   known to {s['median']:.2g} deg (median) and {s['largest']:.2g} deg (largest sigma){edge}"
        )
    out += [f"calibration {_calibrated(c)}" for c in mission.get("calibrations", [])]
    return out


def _calibrated(calibration: dict[str, Any]) -> str:
    """The words of an estimated calibration."""
    c = calibration
    if c["sigma"] is None:
        return f"{c['name']} {c['value']:.4g}, its sigma is not known"
    verdict = f"{100 * c['share']:.3g} % of its sigma before" if c["determined"] else "not determined by these data"
    return f"{c['name']} {c['value']:.4g}, sigma {c['sigma']:.2g} ({verdict})"


def _held(anchor: str) -> str:
    """What holds the track in the world: poses, or files."""
    return f"held in the world by {anchor}" if anchor.endswith(".csv") else f"{anchor} is anchored"


def _percent(number: float) -> str:
    """Percent of the distance; a dash where there is none."""
    return "-" if np.isnan(number) else f"{_short(number)} %"


def _short(number: float) -> str:
    """Three digits; what is below a millionth is rounding."""
    return f"{round(number, 6):.3g}"
