"""Real loop closures, some of them wrong: two public logs with what a place recognizer and a lidar made of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from wrong_closures import X

import nls
from factors import Cauchy
from models.algebra import Array, Mask
from nls import FactorGraph, Values
from nls.metrics import TrajectoryError, ate
from nls.posegraph import closures


@dataclass(frozen=True)
class Recorded:
    """Bovisa04: closures of a place recognizer, some wrong, and a track by GPS.

    Attributes
    ----------
    off : (197,) how much farther or nearer by GPS the ends of a closure are than it says, m.
    """

    graph: FactorGraph
    start: Values
    gps: Array
    loops: Mask
    off: Array

    def error(self, values: Values) -> TrajectoryError:
        """ATE against GPS, rigidly aligned; its pose k belongs to pose 10 k + 8 of the odometry."""
        poses = values.stack(X).X
        at = 10 * np.arange(len(self.gps)) + 8
        return ate(poses[at[at < len(poses)]], self.gps[at < len(poses)], "rigid")


def bovisa(folder: Path) -> Recorded:
    """The log, with its closures compared with GPS."""
    graph, start, _ = nls.load(folder / "Bovisa04_odometry_bow_tr.g2o.gz")
    gps = nls.load(folder / "Bovisa04_GT_GPS.g2o")[1].stack(X).X
    (edges,) = graph.factors
    i, j = (keys.numbers for keys in edges.keys)
    loops = np.abs(i - j) != 1
    at = 10.0 * np.arange(len(gps)) + 8
    here, there = (np.stack([np.interp(end[loops], at, side) for side in gps[:, :2].T], axis=1) for end in (i, j))
    said = np.linalg.norm(np.asarray(edges.z)[loops, :2], axis=1)
    return Recorded(graph, start, gps, loops, np.abs(np.linalg.norm(here - there, axis=1) - said))


def real(folder: Path) -> list[str]:
    """Bovisa04 against GPS, and newcollege_short."""
    log = bovisa(folder)
    far, near = log.off > 5, log.off < 2
    odometry = nls.initialize(log.graph, log.start, "odometry")[0]
    plain = log.graph.optimize(nls.initialize(log.graph, log.start)[0])
    doubted = log.graph.robust(Cauchy(1.0))
    kernel = doubted.optimize(odometry).values
    all_in, ours = nls.gnc(log.graph, odometry, preselect=False), nls.gnc(log.graph, log.start)
    rows = {
        "odometry": (odometry, np.zeros(len(far))),
        "plain": (plain.values, np.ones(len(far))),
        "Cauchy(1), from odometry; rejected: weight below 0.5": (kernel, doubted.factors[0].weights(kernel)[log.loops]),
        "GNC, all in, from odometry": (all_in.result.values, all_in.weights[0][log.loops]),
        "nls.gnc": (ours.result.values, ours.weights[0][log.loops]),
    }
    lines = [
        f"| | ATE [m] | largest [m] | of the {far.sum()} rejected | of the {near.sum()} kept | kept in all |",
        "|:--|" + "--:|" * 5,
    ]
    for name, (values, w) in rows.items():
        error, kept = log.error(values), w >= 0.5
        counts = f"{(~kept[far]).sum()} | {kept[near].sum()} | {kept.sum()} of {len(kept)}"
        lines.append(f"| {name} | {error.rmse:.2f} | {error.largest:.1f} | {counts} |")
        print(lines[-1], flush=True)
    return [
        f"Bovisa04: 11,393 poses in the plane over 1.7 km, {len(far)} closures of a place recognizer. GPS "
        f"contradicts the distance between the ends of {far.sum()} closures by more than 5 m, of {near.sum()} by "
        "less than 2 m. GPS itself is poor in places. ATE against GPS, rigidly aligned.",
        *lines,
        f"The strain of `nls.gnc` is {ours.strain:.2f}, chi2 {ours.result.chi2_final:.4g} with {ours.result.dof} "
        "degrees of freedom.",
        newcollege(folder / "newcollege_short.g2o"),
    ]


def newcollege(path: Path) -> str:
    graph, start, _ = nls.load(path)
    plain = graph.optimize(nls.initialize(graph, start)[0])
    found = nls.gnc(graph, start)
    loops = sum(int(mask.sum()) for mask in closures(graph.pattern(start)))
    return (
        f"newcollege_short: 633 poses in space, {loops} closures, no truth. {len(found.rejected)} are rejected: "
        f"chi2 goes from {plain.chi2_final:.4g} with {plain.dof} degrees of freedom to {found.result.chi2_final:.4g} "
        f"with {found.result.dof}; the strain is {found.strain:.2f}."
    )
