"""Contacts whose names are removed: how many pairs are found again, and how good the track is.

    python benchmarks/evidence/unnamed_contacts.py [--seeds 20] [--processes 1] [--out DIR]

The reference missions `sim.hauv_floor` and `sim.hauv_hull`, seeds 0, 1, 2, ..., with false contacts and with lost ones.
`nls.missions.contacts.associate` has odometry, attitude and the contacts without their landmarks. The graph of what it
found is solved as `nls solve` does, and beside it that of the clean mission with all true names.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from script import Table, make_page, pooled, timed
from wrong_contacts import SCENES, spoiled

from factors import Cauchy, Robust, sonar_factors
from nls import FactorGraph, Values, kinds
from nls.filters.association import pair_precision_recall
from nls.missions.contacts import associate
from nls.plot.picture import write_picture
from nls.plot.style import BEFORE, ECHO, ELLIPSE, ESTIMATE, LANDMARK, REJECTED, TRUE
from nls.starts import search_elevation

SPOILED = ("clean", "5 % false", "10 % false", "20 % false", "40 % false", "30 % lost", "60 % lost")
SWEEP = ("40 % false", "30 % lost", "60 % lost")  # a fifth of the seeds
AXES = {"false contacts": ("clean", "5 % false", "10 % false", "20 % false", "40 % false")}
AXES |= {"lost contacts": ("clean", "30 % lost", "60 % lost")}
LINES = {"precision": ("precision", ESTIMATE), "recall": ("recall", ELLIPSE), "share": ("explained", LANDMARK)}
x, l = kinds("x", "l")


@dataclass(frozen=True)
class Trial:
    """One mission without names."""

    scene: str
    spoiled: str
    precision: float
    recall: float
    share: float
    settled: bool
    ate: float
    named: float
    reckoned: float
    seconds: float


def trial(scene: str, how: str, seed: int) -> Trial:
    """Associate the contacts of one mission, solve, and compare."""
    mission, clean = spoiled(scene, how, seed), spoiled(scene, "clean", seed)
    others, poses = FactorGraph(mission.graph.factors[:4]), Values.of([mission.start.stack("x")])
    associated, seconds = timed(associate, others, poses, mission.contacts, mission.sonar.aperture)
    contacts = associated.sightings
    pose, target = contacts.keys[:2]
    robust = Robust(contacts.noise, Cauchy(2.0))
    factors = sonar_factors(pose, target, contacts.z, robust, mission.sonar, mission.offset, mission.elevation)
    graph = FactorGraph([*others.factors, *factors])
    solved = graph.optimize(search_elevation(graph, associated.values)).values
    true = np.where(mission.wrong, -1, mission.contacts.keys[1].numbers)
    quality = *pair_precision_recall(associated.numbers, true), associated.share, associated.settled
    named = clean.ate(clean.graph.optimize(clean.start).values)
    ate = mission.ate(mission.truth.replaced({"x": solved[x]}))
    return Trial(scene, how, *quality, ate, named, mission.ate(mission.start), seconds)


def rows(trials: list[Trial]) -> list[str]:
    """A row a scene and a way to spoil it."""
    titles = ["scene", "contacts", "seeds", "precision", "recall", "explained", "dead reckoning, m", "true names, m"]
    titles += ["associated, m", "over true names, mean (largest)", "worse than dead reckoning", "settled", "s"]
    table = Table(titles, names=2)
    for scene, how in product(SCENES, SPOILED):
        of = [t for t in trials if (t.scene, t.spoiled) == (scene, how)]
        if not of:
            continue
        names = ("ate", "named", "reckoned", "precision", "recall")
        ate, named, reckoned, precision, recall = (np.array([getattr(t, name) for t in of]) for name in names)
        cells = [scene, how, len(of), f"{precision.mean():.3f}", f"{recall.mean():.3f}"]
        cells += [f"{100 * np.mean([t.share for t in of]):.1f} %", f"{reckoned.mean():.3f}", f"{named.mean():.4f}"]
        cells += [f"{ate.mean():.4f}", f"{ate.mean() / named.mean():.2f} ({(ate / named).max():.2f})"]
        cells += [f"{count} of {len(of)}" for count in ((ate > reckoned).sum(), sum(t.settled for t in of))]
        table.add(*cells, f"{np.mean([t.seconds for t in of]):.0f}")
    return table


def draw(trials: list[Trial], path: Path) -> None:
    """How precision, recall, the explained share and the error of the track go with false and with lost contacts."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for column, (title, ways) in enumerate(AXES.items()):
        percent = np.array([0.0 if name == "clean" else float(name.split()[0]) for name in ways])
        above, below = axes[:, column]
        for scene, line in zip(SCENES, ("o-", "s:"), strict=True):
            of = [[t for t in trials if (t.scene, t.spoiled) == (scene, name)] for name in ways]
            for name, (label, color) in LINES.items():
                y = [100 * np.mean([getattr(t, name) for t in some]) for some in of]
                above.plot(percent, y, line, color=color, label=f"{label}, {scene}")
            ratios = [[t.ate / t.named for t in some] for some in of]
            reckoned = [np.mean([t.reckoned / t.named for t in some]) for some in of]
            below.plot(percent, reckoned, line, color=BEFORE, label=f"dead reckoning, {scene}")
            below.plot(percent, list(map(max, ratios)), line, color=REJECTED, label=f"worst seed, {scene}")
            below.plot(percent, list(map(np.median, ratios)), line, color=ESTIMATE, label=f"median, {scene}")
        if column == 0:
            above.plot(percent, 100 - percent, color=ECHO, linewidth=1, label="true contacts")
        above.set_title(title)
        below.set(xlabel=f"{title} [%]", yscale="log")
        below.axhline(1.0, color=TRUE, linewidth=0.8)
    axes[0, 0].set(ylabel="[%]", ylim=(0, 105))
    axes[1, 0].set(ylabel="ATE / ATE with true names", yticks=[1, 2, 5, 10], yticklabels=["1", "2", "5", "10"])
    for left, right in axes:
        right.legend(*left.get_legend_handles_labels(), fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    write_picture(path, figure)


def page(seeds: int, processes: int, out: Path) -> list[str]:
    """The table, and the picture in its folder."""
    cases = [
        (scene, how, seed)
        for how, scene in product(SPOILED, SCENES)
        for seed in range(max(1, seeds // 5) if how in SWEEP else seeds)
    ]
    trials = []
    for done in pooled(processes, trial, *zip(*cases, strict=True)):
        trials.append(done)
        print(done, file=sys.stderr, flush=True)
    draw(trials, out / "unnamed_contacts.png")
    return [
        "![precision, recall, explained share and error against false and lost contacts](unnamed_contacts.png)",
        *rows(trials),
        "Precision and recall count pairs of contacts of one landmark. Explained: share of contacts with a landmark. "
        "Columns in m: ATE, not aligned, mean of the seeds; *true names* is the clean mission. Settled: the last "
        "round merged almost nothing. s: processor time of the association.",
    ]


if __name__ == "__main__":
    counts = {"seeds": (20, "of every row"), "processes": (1, "at once")}
    make_page("Contacts without names", page, **counts)
