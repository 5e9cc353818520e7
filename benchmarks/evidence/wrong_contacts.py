"""Wrong contacts of a sonar: what dead reckoning, the run without any wrong ones, and ``nls solve`` make of a mission.

    python benchmarks/evidence/wrong_contacts.py [--seeds 20] [--jobs 2] [--out DIR]

The reference missions `sim.hauv_floor` and `sim.hauv_hull` with false contacts anywhere in the image, contacts that are
exchanged with that of a neighbor, and contacts that are lost. Each is solved as ``nls solve`` does by default: with all
contacts; where some are wrong and no calibration explains the misfit, by `nls.gnc` from dead reckoning. Here the
solution with all contacts begins at dead reckoning and ends after 20 steps where it has not converged; ``nls solve``
tries several starts and goes on to the optimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from script import Table, make_page, pooled, spread, timed

import nls
import sim
from nls.analysis.swapped_landmarks import exchanged_contacts
from nls.cli.outliers import choice_of
from nls.io import LoadReport

STEPS = 20  # of the solution with all contacts
SCENES: dict[str, Callable[..., sim.Mission]] = {"floor": sim.hauv_floor, "hull": sim.hauv_hull}
SPOILED = ("none", "5 % false", "10 % false", "20 % false", "5 % exchanged", "10 % exchanged", "30 % lost")


@dataclass(frozen=True)
class Run:
    """One mission: errors of its track, m, and what was rejected.

    Attributes
    ----------
    dead, ate : ATE of dead reckoning and of the default solution.
    judged : whether the plain solution said that contacts are wrong, and a choice was taken.
    rejected, right, wrong, left : contacts without a say, those that are wrong among them, all wrong ones, and
        landmarks that left.
    named, rightly : contacts that are named as exchanged, as ``nls explain`` does, and those that are wrong among them.
    seconds : processor time of the plain solution and of the choice.
    """

    dead: float
    ate: float
    judged: bool
    rejected: int
    right: int
    wrong: int
    left: int
    named: int
    rightly: int
    seconds: tuple[float, float]


def spoiled(scene: str, how: str, seed: int) -> sim.Mission:
    """The mission of a scene and a seed with so many of its contacts false, exchanged or lost."""
    percent, _, word = how.partition(" % ")
    option = {"false": "outliers", "exchanged": "wrong_associations", "lost": "drop_outs"}.get(word)
    return SCENES[scene](np.random.default_rng(seed), **({option: int(percent) / 100} if option else {}))


def run(scene: str, seed: int) -> list[Run]:
    """The mission of a scene and a seed in every way it is spoiled."""
    return [solved(spoiled(scene, how, seed)) for how in SPOILED]


def solved(mission: sim.Mission) -> Run:
    """The default solution."""
    few = nls.LevenbergMarquardt(nls.Stop(max_iterations=STEPS))
    plain, first = timed(mission.graph.optimize, mission.start, few)
    values, left = plain.values, 0
    out = [np.zeros(len(factor), dtype=bool) for factor in mission.graph.factors]
    report = LoadReport("", "mission", "3-D", "log")
    choice, second = timed(choice_of, mission.graph, mission.start, plain, report)
    if choice is not None:
        values, out, left = choice.result.values, [w == 0 for w in choice.weights], len(choice.left)
    wrong, rejected = mission.wrong, out[4]
    named = [i for pair in exchanged_contacts(mission.graph, values, out) for _, i in pair.places]
    counts = int(rejected.sum()), int((rejected & wrong).sum()), int(wrong.sum()), left, len(named)
    rightly, judged_wrong = int(wrong[named].sum()), bool(rejected.any())
    return Run(mission.ate(mission.start), mission.ate(values), judged_wrong, *counts, rightly, (first, second))


def table(scene: str, found: list[list[Run]]) -> list[str]:
    """A row for every way a mission is spoiled."""
    titles = ["wrong contacts", "dead reckoning, m", "solved, m", "times the clean run", "worse than dead reckoning"]
    titles += ["judged", "rejected", "landmarks removed", "precision", "recall", "named as exchanged (right)"]
    rows = Table([*titles, "plain, s", "choice, s"])
    clean = np.array([runs[0].ate for runs in found])
    for way, runs in zip(SPOILED, zip(*found, strict=True), strict=True):
        ate, dead = np.array([r.ate for r in runs]), np.array([r.dead for r in runs])
        rejected, right, wrong = (sum(getattr(r, name) for r in runs) for name in ("rejected", "right", "wrong"))
        times = f"{ate.mean() / clean.mean():.2f} ({(ate / clean).min():.2f}-{(ate / clean).max():.2f})"
        cells = [way, spread(dead), spread(ate), times, f"{(ate > dead).sum()}/{len(runs)}"]
        cells += [f"{sum(r.judged for r in runs)}/{len(runs)}"]
        cells += [f"{rejected / len(runs):.0f} of {wrong / len(runs):.0f}", f"{np.mean([r.left for r in runs]):.1f}"]
        cells += [share(right, rejected), share(right, wrong)]
        cells += [f"{np.mean([r.named for r in runs]):.0f} ({np.mean([r.rightly for r in runs]):.0f})"]
        rows.add(*cells, *(f"{seconds:.1f}" for seconds in np.mean([r.seconds for r in runs], axis=0)))
    return [f"## {scene.capitalize()}", *rows]


def share(part: int, whole: int) -> str:
    """A part of a whole; a dash where there is none."""
    return f"{part / whole:.3f}" if whole else "-"


def page(seeds: int, jobs: int) -> list[str]:
    """The tables of both scenes."""
    return [
        *(line for scene in SCENES for line in table(scene, list(pooled(jobs, partial(run, scene), range(seeds))))),
        f"- Means over seeds 0 to {seeds - 1}, and least and most. ATE: rmse of positions, nothing aligned.",
        "- Times the clean run: mean ATE divided by the mean ATE without wrong contacts. Brackets: the "
        "least and most of a seed.",
        "- Judged: missions whose plain solution reported wrong contacts.",
        "- Rejected: contacts, of how many wrong ones. Contacts of removed landmarks count, too. About one right "
        "contact in a hundred is rejected by chance.",
        "- Named as exchanged: contacts that `nls explain` names in pairs.",
        f"- Plain: processor time of the solution with all contacts, here of at most {STEPS} steps from dead "
        "reckoning. Choice: processor time of the rest.",
    ]


if __name__ == "__main__":
    counts = {"seeds": (20, "missions of every row"), "jobs": (2, "processes")}
    make_page("Wrong contacts of a sonar", page, **counts)
