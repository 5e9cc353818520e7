"""`nls.Incremental` on landmarks passed at 0 to 6 m: does an update fail, and is the end the batch solution?

    python benchmarks/evidence/updates.py [--clean N] [--wrong N] [--processes N]

80 poses on a circle, 15 landmarks by bearing and range. In the second half of the worlds 5 % of the sightings name a
wrong landmark; these are taken out at the end, all at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from time import process_time

import numpy as np
from script import make_page, markdown, pooled

import nls
from factors import BearingRange, Between, Diagonal, Factor, Isotropic, Prior
from models import SE2, R
from models.algebra import wrap
from nls import FactorGraph, Values

x, l = nls.kinds("x", "l")
POSES, LANDMARKS, REACH, SHARE, TOL = 80, 15, 6.0, 0.05, 1e-4
ODOMETRY, SIGHTING = (0.05, 0.05, 0.01), (0.02, 0.1)
STEP, SEEN = Diagonal(x=0.05, y=0.05, yaw=0.01), Diagonal(bearing=0.02, range=0.1)


@dataclass
class World:
    """What is given, update by update; the wrong ones among it, the true poses and landmarks, and the start."""

    updates: list[Factor]
    wrong: set[int]
    truth: Values
    start: Values
    nearest: float


def world(seed: int, share: float) -> World:
    """A drive of two circles."""
    rng = np.random.default_rng(seed)
    L, angle = rng.uniform(-12, 12, (LANDMARKS, 2)), np.linspace(0, 4 * np.pi, POSES)
    T = np.stack([8 * np.cos(angle), 8 * np.sin(angle), angle + np.pi / 2], axis=1)
    updates: list[Factor] = [Prior(x[0], T[0], Isotropic(0.01))]
    wrong, nearest = set(), np.inf
    for k in range(1, POSES):
        step = SE2.between(T[k - 1 : k], T[k : k + 1])[0] + rng.normal(0, ODOMETRY)
        updates.append(Between(x[k - 1], x[k], step, STEP))
        away = L - T[k, :2]
        ranges, bearings = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - T[k, 2]
        nearest = min(nearest, float(ranges.min()))
        for j in np.flatnonzero(ranges < REACH).tolist():
            bearing, distance = np.array([bearings[j], ranges[j]]) + rng.normal(0, SIGHTING)
            if distance <= 0:  # no sonar reports one
                continue
            name = int(rng.integers(LANDMARKS)) if rng.random() < share else j
            updates.append(BearingRange(x[k], l[name], [wrap(bearing), distance], SEEN))
            if name != j:
                wrong.add(id(updates[-1]))
    truth = Values({x: (SE2, T), l: (R(2), L)})
    return World(updates, wrong, truth, Values({x: (SE2, T[:1]), l: (R(2), np.zeros((0, 2)))}), nearest)


@dataclass
class Trial:
    """What became of a world.

    Attributes
    ----------
    failed : the errors of updates, of right measurements and of wrong ones.
    above : updates after which the gap was above the tolerance.
    batches : updates that needed a batch solution.
    off : chi2 at the end above the lowest of the batch solutions, as a part of it.
    removal : the error of the removal, if any.
    """

    seed: int
    nearest: float
    updates: int
    wrong: int
    failed: dict[bool, list[str]] = field(default_factory=lambda: {True: [], False: []})
    above: int = 0
    batches: int = 0
    off: float = np.nan
    removal: str = ""
    seconds: float = 0.0

    @property
    def equal(self) -> bool:
        """Whether the end is within the tolerance of the batch solution."""
        return not self.removal and self.off <= TOL


def tried(share: float, seed: int) -> Trial:
    """A world, driven through."""
    given, began, smoother = world(seed, share), process_time(), nls.Incremental(TOL)
    trial = Trial(seed, given.nearest, len(given.updates), len(given.wrong))
    taken = []
    for k, factor in enumerate(given.updates):
        before = smoother.batch_solutions
        try:
            smoother.update(factor, given.start if k == 0 else None)
        except nls.LeadlineError as error:
            trial.failed[id(factor) not in given.wrong].append(type(error).__name__)
        else:
            taken.append(factor)
        trial.above += smoother.gap > TOL * max(smoother.chi2, 1.0)
        trial.batches += smoother.batch_solutions > before
    try:
        smoother.remove([factor for factor in taken if id(factor) in given.wrong])
    except nls.LeadlineError as error:
        trial.removal = type(error).__name__
    trial.seconds = process_time() - began
    graph = FactorGraph([factor for factor in given.updates if id(factor) not in given.wrong])
    known = {kind: stack.numbers for kind, stack in smoother.values.stacks.items()}
    starts = [smoother.values, Values({x: (SE2, given.truth[x]), l: (R(2), given.truth[l[known["l"]]], known["l"])})]
    if not trial.failed[True]:
        best = min(chi2_of(graph, start) for start in starts)
        trial.off = (smoother.chi2 - best) / max(best, 1.0)
    return trial


def chi2_of(graph: FactorGraph, start: Values) -> float:
    """chi2 of the batch solution; infinite where there is none, as at a landmark that touches a pose."""
    try:
        return graph.optimize(start).chi2_final
    except nls.UnderconstrainedError:
        return np.inf


def summed(name: str, trials: list[Trial]) -> list[object]:
    """A row of the table."""
    updates, wrong, batches, above, equal = (
        sum(getattr(trial, attribute) for trial in trials)
        for attribute in ("updates", "wrong", "batches", "above", "equal")
    )
    failed = (sum(len(trial.failed[right]) for trial in trials) for right in (True, False))
    cells = [name, len(trials), updates, wrong, *failed, batches, above]
    cells += [sum(bool(trial.removal) for trial in trials), equal, f"{max(trial.off for trial in trials):.1e}"]
    return [*cells, f"{np.median([1e3 * trial.seconds / trial.updates for trial in trials]):.1f}"]


def page(clean: int, wrong: int, processes: int) -> list[str]:
    """The page without its head."""
    rows = []
    for name, share, count in (("right names", 0.0, clean), ("5 % wrong names", SHARE, wrong)):
        trials = list(pooled(processes, partial(tried, share), range(count)))
        for trial in trials:
            if not trial.equal or any(trial.failed.values()):
                print(name, trial, flush=True)
        rows.append(summed(name, trials))
    heads = ("worlds", "how many", "updates", "wrong ones", "right ones that failed", "wrong ones that failed")
    more = ("by a batch solution", "gap above tol", "removals that failed", "ends at the batch", "farthest off", "ms")
    return [
        f"- {POSES} poses, {LANDMARKS} landmarks seen up to {REACH:g} m, one measurement an update, tol {TOL:g}",
        "- *ends at the batch*: chi2 is within tol of the lowest batch solution of the right measurements, started at "
        "the smoother's end and at the truth; wrong measurements are removed first",
        "- *farthest off*: the largest of these differences, relative to chi2; *ms*: median of an update",
        *markdown((*heads, *more), rows),
    ]


if __name__ == "__main__":
    counts = {"clean": (200, "worlds without wrong names"), "wrong": (50, "worlds with wrong names")}
    make_page("Incremental updates near landmarks", page, **counts, processes=(2, "at once"))
