"""Filters and graphs on two public logs with landmarks: against motion capture, and against GPS.

    LEADLINE_DATA=FOLDER python benchmarks/evidence/landmark_logs.py [--out DIR] [--images DIR]

MRCLAM dataset 6: landmarks known by their barcodes. Victoria Park: trees without names. Every estimator is fed with the
factors of the same graph.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from logs import read_mrclam, read_victoria_park
from mrclam import BEARING, DENSITY, RANGE, mrclam
from mrclam import l as landmark
from script import Table, make_page, timed
from victoria_park import Park, victoria_park, x

from factors import Cauchy
from models import SE2
from models.algebra import Array
from models.errors import GraphWarning
from nls import FactorGraph, Values
from nls.filters.association import JointCompatibility, Nearest
from nls.filters.base import Track
from nls.filters.ekf import EKF
from nls.filters.fastslam import FastSLAM
from nls.filters.smoother import Smoother
from nls.metrics import TrajectoryError
from nls.plot.picture import write_picture
from nls.plot.style import BEFORE, ESTIMATE, LANDMARK, SIGHT, TRUE
from sim import LandmarkWorld
from sim.estimators import batch

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KERNEL = Cauchy(2.0)
WRONG = 0.1  # weight below which a sighting is taken for one of something else: 6 sigma of this kernel
PARTICLES, LAG, SEEDS = 100, 20, (1, 2, 3)


@dataclass(frozen=True)
class Row:
    """An estimator on the log of a robot.

    Attributes
    ----------
    ate, aligned : rmse of the poses when each was the latest, m, from the true start and rigidly aligned.
    smoothed : of the poses as they are believed in the end, m, not aligned.
    landmarks, shape : rms error of the landmarks, m, as they are and after the alignment of the poses.
    nees : mean over the poses; None for particles.
    ms : processor time of a step.
    """

    track: Track
    ate: float
    aligned: float
    smoothed: float
    landmarks: float
    shape: float
    nees: float | None
    ms: float

    def __str__(self) -> str:
        sizes = (self.ate, self.aligned, self.smoothed, self.landmarks, self.shape)
        nees = "" if self.nees is None else f"{self.nees:.3g}"
        return " | ".join([*(f"{size:.3f}" for size in sizes), nees, f"{self.ms:.2g}"])


def measured(world: LandmarkWorld, run: Callable[[LandmarkWorld], Track]) -> Row:
    """What a run finds in a world."""
    track, seconds = timed(run, world)
    raw, aligned, smoothed = (
        track.ate(world.truth),
        track.ate(world.truth, "rigid"),
        track.ate(world.truth, smoothed=True),
    )
    L, true = track.values[track.landmarks], world.truth[track.landmarks]
    turned = SE2.act(np.broadcast_to(aligned.T, (len(L), 3)), L)
    off, shape = (float(np.sqrt(np.square(each - true).sum(axis=1).mean())) for each in (L, turned))
    nees = None if "FastSLAM" in track.method else float(track.nees(world.truth).mean())
    return Row(track, raw.rmse, aligned.rmse, smoothed.rmse, off, shape, nees, 1e3 * seconds / world.poses)


def by(estimator: Callable[[], Any]) -> Callable[[LandmarkWorld], Track]:
    """A run of a filter."""
    return lambda world: estimator().run(world.graph, world.start)


def robust(world: LandmarkWorld) -> LandmarkWorld:
    """The world with a kernel on the sightings."""
    return replace(world, graph=FactorGraph([world.first, world.odometry, world.sightings.robust(KERNEL)]))


def without_wrong(world: LandmarkWorld) -> LandmarkWorld:
    """The world without the sightings that the robust graph gives next to no weight."""
    other = robust(world)
    weights = other.sightings.weights(batch(other).values)
    return replace(world, graph=FactorGraph([world.first, world.odometry, world.sightings[weights >= WRONG]]))


def particles(version: Literal[1, 2], seed: int) -> Callable[[LandmarkWorld], Track]:
    """A run of FastSLAM."""
    return by(lambda: FastSLAM(PARTICLES, version, rng=np.random.default_rng([seed, version])))


AS_LOGGED: dict[str, Callable[[LandmarkWorld], Track]] = {
    "EKF": by(EKF),
    "EKF, gate 0.9999": by(lambda: EKF(gate=0.9999)),
    "EKF, first estimates, gate 0.9999": by(lambda: EKF(gate=0.9999, first_estimates=True)),
    "graph": batch,
    f"graph, {KERNEL}": lambda world: batch(robust(world)),
}
WITHOUT_WRONG: dict[str, Callable[[LandmarkWorld], Track]] = {
    "EKF": by(EKF),
    "EKF, first estimates": by(lambda: EKF(first_estimates=True)),
    **{f"FastSLAM {v}.0, {PARTICLES} particles, seed {k}": particles(v, k) for v in (1, 2) for k in SEEDS},
    f"fixed lag {LAG}, landmarks stay": by(lambda: Smoother(LAG, "stay")),
    "online": by(Smoother),
    "graph": batch,
}


def robot_table(world: LandmarkWorld, estimators: dict[str, Callable[[LandmarkWorld], Track]]) -> dict[str, Row]:
    """Every estimator; one that did not converge says so in its name."""
    rows = {}
    for name, run in estimators.items():
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", GraphWarning)
            row = measured(world, run)
        rows[name + (" (not converged)" if any("batch" in str(w.message) for w in said) else "")] = row
        print(f"{world.name}: {name}: {row}", flush=True)
    return rows


def rows_of(world: LandmarkWorld, rows: dict[str, Row]) -> list[str]:
    table = Table(["estimator", "ATE", "aligned", "smoothed", "landmarks", "aligned", "NEES", "ms a step"])
    reckoning = f"| dead reckoning | {world.ate(world.start):.3f} | {world.ate(world.start, 'rigid'):.3f} | | | | | |"
    return [*table, reckoning, *(f"| {name} | {row} |" for name, row in rows.items())]


def robots(data: Path, images: Path | None) -> list[str]:
    """The part of the page on MRCLAM."""
    lines = [
        "## MRCLAM dataset 6: landmarks with names",
        "- There is a pose at every time at which a landmark was seen. Between poses velocity commands are integrated.",
        f"- Noise of the commands is white: {DENSITY[0, 0]:g} m/s ahead, {DENSITY[1, 1]:g} m/s across and "
        f"{DENSITY[2, 2]:g} rad/s per sqrt(Hz).",
        f"- Bearings have a sigma of {BEARING:g} rad, ranges of {100 * RANGE:g} %. All sigmas were tuned on these "
        "logs. Sightings of other robots are not used.",
        "- The first pose is the true one (1 mm, 0.1 mrad), so nothing has to be aligned. *Aligned* is after the "
        "rigid motion that fits the poses best.",
        "- Lengths are in m, rms. ATE: each pose when it was the latest. Smoothed: as believed in the end.",
        "- Landmarks: 15, against the survey. NEES: mean over all poses, 3 expected.",
    ]
    for number in (3, 5):
        world = mrclam(read_mrclam(data / "mrclam6", number), f"robot {number}")
        cleaned = without_wrong(world)
        off = len(world.sightings) - len(cleaned.sightings)
        logged, clean = robot_table(world, AS_LOGGED), robot_table(cleaned, WITHOUT_WRONG)
        lines += [
            f"### Robot {number}: {world.poses} poses, {len(world.sightings)} sightings of {world.landmarks} landmarks",
            "As logged:",
            *rows_of(world, logged),
            f"Without the {off} sightings whose weight in the robust graph is below {WRONG:g}:",
            *rows_of(cleaned, clean),
        ]
        if images is not None and number == 3:
            robot_picture(world, logged, images / "mrclam.png")
    lines += [
        "- Some barcodes are misread as those of other landmarks. They move whole landmarks by meters in a filter "
        "without a gate, and in a graph without a kernel.",
        "- A sighting is more accurate than the robot's heading when it first sees the map. The plain EKF takes its "
        "Jacobians at changing estimates, so the filter believes that it has measured the heading. The map of robot 5 "
        "ends up turned; its shape is nearly as good as that of the others. With first estimates, and in a graph, the "
        "map is not turned.",
        "- An NEES above 3 remains for all. The sigmas are right: residuals at the truth have a standard deviation of "
        "0.9 to 1.2 of them. But errors are correlated in time. Range errors of one landmark are correlated by 0.9 "
        "from one sighting to the next, and by 0.6 after 3 s. Every estimator here treats them as independent.",
    ]
    return lines


def robot_picture(world: LandmarkWorld, rows: dict[str, Row], path: Path) -> None:
    """Track and landmarks beside the truth: EKF, EKF with a gate, robust graph; nothing aligned."""
    from matplotlib.figure import Figure

    chosen = [name for name in rows if name in ("EKF", "EKF, gate 0.9999", f"graph, {KERNEL}")]
    figure = Figure(figsize=(10.5, 6.8), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for axes, name in zip(panels, chosen, strict=True):
        row, truth = rows[name], world.truth
        X = row.track.values[row.track.x]
        axes.plot(*truth[x][:, :2].T, color=SIGHT, linewidth=0.8, label="true track")
        axes.plot(*X[:, :2].T, color=ESTIMATE, linewidth=0.8, label="estimate")
        L, true = row.track.values[row.track.landmarks], truth[row.track.landmarks]
        axes.plot(*np.stack([L, true]).transpose(2, 0, 1), color=LANDMARK, linewidth=0.8)
        axes.plot(*true.T, "+", color=TRUE, markersize=8, label="surveyed landmarks")
        axes.plot(*L.T, "o", color=LANDMARK, markersize=5, label="estimated landmarks")
        axes.set(title=f"{name}: ATE {row.smoothed:.2f} m", xlabel="x [m]", aspect="equal")
    panels[0].set_ylabel("y [m]")
    panels[-1].legend(loc="lower left", fontsize=9)
    figure.suptitle(f"MRCLAM 6, {world.name}, 15 minutes, some barcodes misread; nothing is aligned")
    write_picture(path, figure)


# --- Victoria Park ----------------------------------------------------------------------------------------------------


def park_row(name: str, error: TrajectoryError, graph: FactorGraph | None, seconds: float) -> list[object]:
    """Cells of the table: with how many landmarks there are, and how many of them are seen often."""
    median, tenth = np.percentile(error.distances, [50, 90])
    cells = [name, f"{error.rmse:.2f}", f"{median:.2f}", f"{tenth:.2f}", f"{error.largest:.1f}"]
    if graph is None:
        return [*cells, "", "", ""]
    seen = np.bincount(graph.factors[2].keys[1].numbers)
    return [*cells, (seen > 0).sum(), (seen >= 10).sum(), f"{seconds:.1f}"]


def solve(graph: FactorGraph, start: Values) -> tuple[Values, float]:
    result, seconds = timed(graph.optimize, start)
    assert result.converged, result.reason
    return result.values, seconds


def trees(data: Path, images: Path | None) -> list[str]:
    """The part of the page on Victoria Park."""
    park = victoria_park(read_victoria_park(data / "victoria-park"))
    table, found = Table(["estimator", "rmse", "median", "90 %", "largest", "trees", "seen 10 times", "s"]), {}

    def add(name: str, X: Array, graph: FactorGraph | None, seconds: float) -> None:
        table.add(*park_row(name, park.gps_error(X), graph, seconds))

    add("dead reckoning", park.start[x], None, 0.0)
    for associate in (JointCompatibility(0.99), Nearest(0.99)):
        ekf = EKF(associate=associate)
        track, seconds = timed(ekf.run, park.graph, park.start)
        found[type(associate).__name__] = np.array(ekf.associations)
        graph, start = park.named(ekf.associations, track.X)
        add(track.method, track.X, graph, seconds)
    names = np.array(ekf.associations)
    differ = int((found["JointCompatibility"] != names).sum())
    solved, seconds = solve(graph, start)
    add("graph, trees of the EKF", solved[x], graph, seconds)
    kernel = FactorGraph([*graph.factors[:2], graph.factors[2].robust(KERNEL)])
    values, seconds = solve(kernel, start)
    add(f"the same, {KERNEL}", values[x], kernel, seconds)
    again = park.again(solved)
    graph, start = park.named(again, solved[x])
    last, seconds = solve(graph, start)
    add("graph, trees found again", last[x], graph, seconds)
    odometry, poses = FactorGraph(park.graph.factors[:2]), Values.of([park.start.stack("x")])
    associated, first = timed(associate, odometry, poses, park.sightings)
    named, start = park.named(associated.numbers, associated.values[x])
    at_once, seconds = solve(named, start)
    add("graph, all trees at once", at_once[x], named, first + seconds)
    both = (again >= 0) & (associated.numbers >= 0)
    shared, _ = solve(*park.named(np.where(both, again, -1), last[x]))
    if images is not None:
        park_picture(park, track.X, last, images / "victoria-park.png")
    n = len(park.sightings)
    chi2 = graph.chi2(last) / (2 * (again >= 0).sum() + 3 * len(park.t))
    return [
        "## Victoria Park: trees without names",
        f"- The log has {park.scans} scans in {park.t[-1] - park.t[0]:.0f} s. There is a pose at each of the "
        f"{len(park.t)} scans for which the wheel had rolled on by 2 cm.",
        f"- Of {park.seen} sightings {n} are used: those made near the same place in 3 of the 10 scans around.",
        "- Odometry: wheel speed and steering through `models.vehicles.ackermann`. Sigmas and the direction of the "
        "laser (1.1 deg to the right) come from scans 1 s apart; see `victoria_park.py`.",
        f"- Lengths in m: distance of the {len(park.gps_error(last[x]).distances)} GPS fixes from the track. Each "
        "track is first aligned rigidly with the fixes, as no absolute heading is measured.",
        "- GPS has gaps of up to 3 minutes and jumps of several meters. Its antenna is not where the laser is.",
        *table,
        f"- The two associations differ in {differ} of {n} sightings.",
        "- *Found again*: each sighting goes to the nearest tree of the first solution, up to 2 m. Then the graph "
        f"is solved once more. {int((again != names).sum())} sightings change their tree, {int((again < 0).sum())} "
        "are left out.",
        f"- chi2 of that solution is {chi2:.2f} of its number of residuals. Sigmas are wide on purpose: the gates of "
        "the filter depend on them.",
        f"- *All trees at once*: `nls.missions.contacts.associate`, from dead reckoning. {associated}. With the "
        f"trees found again, the same {both.sum()} sightings are {park.gps_error(shared[x]).rmse:.2f} m off.",
    ]


def park_picture(park: Park, filtered: Any, values: Values, path: Path) -> None:
    """Dead reckoning and EKF, graph and trees, both beside GPS."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 6.5), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    seen = park.log.gps[(park.log.t_gps >= park.t[0]) & (park.log.t_gps <= park.t[-1])]

    def draw(axes: Axes, X: Any, color: str, label: str) -> TrajectoryError:
        error = park.gps_error(X)
        axes.plot(*SE2.act(np.broadcast_to(error.T, (len(X), 3)), X[:, :2]).T, color=color, linewidth=1, label=label)
        return error

    draw(left, park.start[x], BEFORE, "dead reckoning")
    error = draw(left, filtered, ESTIMATE, "EKF")
    left.set(title=f"EKF: {error.rmse:.1f} m rmse from GPS", xlabel="east [m]", ylabel="north [m]", aspect="equal")
    error = draw(right, values[x], ESTIMATE, "graph")
    trees = values.stack(landmark.name).X
    right.plot(*SE2.act(np.broadcast_to(error.T, (len(trees), 3)), trees).T, "^", color=LANDMARK, ms=4, label="trees")
    right.set(title=f"graph: {error.rmse:.1f} m rmse from GPS", xlabel="east [m]", aspect="equal")
    for axes in (left, right):
        axes.plot(*seen.T, ".", color=TRUE, markersize=3, label="GPS")
        axes.legend(loc="upper left", fontsize=9)
    figure.suptitle("Victoria Park, 26 minutes, 4 km, trees without names")
    write_picture(path, figure)


def page(data: Path, images: Path | None) -> list[str]:
    """Both parts."""
    return robots(data, images) + trees(data, images)


if __name__ == "__main__":
    where = {"type": Path, "metavar": "DIR", "help": "for mrclam.png and victoria-park.png"}
    make_page("Filters and graphs on public logs with landmarks", page, file="landmark-logs.md", images=where)
