"""Sigmas that the residuals show, on public logs: errors, sigmas and NEES before and after, and a simulated twin.

    LEADLINE_DATA=FOLDER python benchmarks/evidence/sigmas.py [--out DIR] [--seeds N]

GOATS 14 and 15 state sigmas that explain neither sensor. plaza2 and Victoria Park must not get worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from logs import read_victoria_park
from script import Table, make_page
from victoria_park import victoria_park

import nls
from factors import Cauchy, Huber, Isotropic, Prior
from factors.base import Factor, Model
from factors.replaced import replaced
from factors.robust import EFFICIENT, Kernel
from models import SE2
from models.algebra import Array, Mask
from models.chi_squared import chi2_gate
from nls import FactorGraph, Keys, Marginals, Result, Values, variance_components
from nls.analysis import VarianceComponents
from nls.filters.association import Nearest
from nls.filters.consistency import nees_bounds
from nls.filters.ekf import EKF
from nls.metrics import ate

HUBER, CAUCHY = Huber(EFFICIENT["huber"]), Cauchy(EFFICIENT["cauchy"])
A, L, x = nls.kinds("A", "L", "x")
BEACONS = ("fixed", "with priors", "unknown")
SURVEYED = 1.0  # m, stated for the places of beacons: a guess, whose scale is estimated as that of any kind
Groups = Literal["kinds", "units", "components"]


@dataclass(frozen=True)
class Method:
    """A way to solve: with a kernel or none, with stated sigmas (None) or with scales by groups."""

    kernel: Kernel | None
    groups: Groups | None

    def __str__(self) -> str:
        sigmas = "stated" if self.groups is None else "estimate" + (f":{self.groups}" if self.groups != "kinds" else "")
        return f"{sigmas} | {'' if self.kernel is None else type(self.kernel).__name__}"


METHODS = [Method(k, g) for k in (None, HUBER, CAUCHY) for g in (None, "kinds", "units")]


@dataclass(frozen=True)
class Solution:
    """A solved graph: with its noise, its optimum, and the scales where there are some."""

    graph: FactorGraph
    result: Result
    scales: VarianceComponents | None

    @property
    def values(self) -> Values:
        return self.result.values

    @property
    def scale_text(self) -> str:
        if self.scales is None:
            return ""
        rows = [(c.name, f"{c.scale:.3g} ± {c.sigma:.2g}" if c.known else "kept") for c in self.scales.components]
        return "; ".join(f"{name} {scale}" for name, scale in rows) + ("" if self.scales.settled else " (not settled)")


def solve(graph: FactorGraph, values: Values, method: Method) -> Solution:
    """The optimum from the start that the library chooses."""
    if method.kernel is not None:
        graph = graph.robust(method.kernel)
    return solve_from(graph, nls.initialize(graph, values)[0], method.groups)


def solve_from(graph: FactorGraph, start: Values, groups: Groups | None) -> Solution:
    """The optimum from a start."""
    if groups is None:
        return Solution(graph, graph.optimize(start), None)
    scales = variance_components(graph, start, groups)
    return Solution(scales.graph, scales.result, scales)


@dataclass(frozen=True)
class Judged:
    """Positions of the vehicle against the truth: rms, after rigid alignment, rms sigma, NEES of every pose."""

    rms: float
    rigid: float
    sigma: float
    nees: Array

    def __str__(self) -> str:
        inside = 100 * float((self.nees < chi2_gate(2, 0.95)).mean())
        return f"{self.rms:.2f} | {self.rigid:.2f} | {self.sigma:.2f} | {self.nees.mean():.3g} | {inside:.0f} %"


def judged(solution: Solution, truth: Values, kind: str) -> Judged:
    """All poses but the first; where that is the gauge, it stands where the truth has it."""
    n = len(truth.stack(kind))
    keys = Keys(kind, truth.stack(kind).numbers)
    X, true = solution.values[keys], truth[keys]
    marginals = Marginals(solution.graph, solution.values)
    P = marginals.all(nls.kinds(kind)[0], view="position")
    if marginals.gauge == f"{keys[0]!r} fixed":
        motion = SE2.compose(true[:1], SE2.inverse(X[:1]))
        turn = np.array([[np.cos(motion[0, 2]), -np.sin(motion[0, 2])], [np.sin(motion[0, 2]), np.cos(motion[0, 2])]])
        X, P = SE2.compose(np.broadcast_to(motion, X.shape), X), turn @ P @ turn.T
    e = (true[:, :2] - X[:, :2])[1:]
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(P[1:]), e)
    sigma = float(np.sqrt(np.trace(P[1:], axis1=1, axis2=2).mean()))
    assert len(nees) == n - 1
    return Judged(ate(X, true).rmse, ate(X, true, "rigid").rmse, sigma, nees)


# --- GOATS ------------------------------------------------------------------------------------------------------------


def goats(data: Path, number: int, beacons: str) -> tuple[FactorGraph, Values]:
    """The graph with beacons as in `BEACONS`, and the vertices of the file."""
    graph, values, _ = nls.load(data / "range-only" / f"goats_{number}.pyfg.gz")
    if beacons == "fixed":
        graph.fix(Keys("L", values.stack("L").numbers))
    if beacons == "with priors":
        ranged = L[np.unique(graph.factors[1].keys[1].numbers)]
        graph.add(Prior(ranged, values[ranged], Isotropic(SURVEYED)))
    return graph, values


def goats_tables(data: Path) -> tuple[list[str], dict[tuple[int, str], Solution]]:
    """Every method, and the solutions with one scale a unit under Cauchy."""
    lines, kept = [], {}
    for number, beacons in product((14, 15), BEACONS):
        graph, values = goats(data, number, beacons)
        table = Table(["sigmas", "kernel", "ATE", "rigid", "sigma", "NEES", "inside 95 %", "scales"], "llrrrrrl")
        for method in METHODS:
            solution = solve(graph, values, method)
            table.add(method, judged(solution, values, "A"), solution.scale_text)
            if method == Method(CAUCHY, "units"):
                kept[number, beacons] = solution
        lines += [f"### GOATS {number}, beacons {beacons}", *table]
    return lines, kept


def residuals_at(factor: Factor, values: Values) -> tuple[Model, Array]:
    """The bound factor and its residuals (n, m) in units of the measurement."""
    model, X = values.gather(factor)
    return model, np.asarray(
        model.error(*X) / model.W if model.W.ndim == 2 else np.linalg.solve(model.W, model.error(*X)[..., None])[..., 0]
    )


def reasons(data: Path, kept: dict[tuple[int, str], Solution]) -> list[str]:
    """What the file's poses say of the measurements, beside what the solution says."""
    titles = ["log", "ranges: rms of residuals at the truth", "at the solution", "medians by beacon at the truth"]
    table = Table([*titles, "lag 1, 10", "steps x, y: rms at the truth", "at the solution"], "lrrlrrr")
    for number in (14, 15):
        graph, truth = goats(data, number, "fixed")
        steps, ranges = graph.factors
        at = kept[number, "fixed"].values
        (_, r), (_, r_at) = residuals_at(ranges, truth), residuals_at(ranges, at)
        (_, e), (_, e_at) = residuals_at(steps, truth), residuals_at(steps, at)
        right = np.abs(r_at[:, 0]) < 15  # the others are outliers of both
        beacon = ranges.keys[1].numbers
        medians = ", ".join(f"{np.median(r[beacon == k]):+.1f}" for k in np.unique(beacon))
        lags = ", ".join(f"{lagged(r[:, 0], beacon, right, lag):.2f}" for lag in (1, 10))
        *of_ranges, at_truth, there = (f"{rms(a):.2f} m" for a in (r[right], r_at[right], e[:, :2], e_at[:, :2]))
        table.add(f"GOATS {number}", *of_ranges, f"{medians} m", lags, at_truth, there)
    return table


def controls(data: Path) -> list[str]:
    """Scales of the ranges where these belong to another pose, or the speed of sound is another; beacons fixed."""
    table = Table(["ranges", "GOATS 14", "GOATS 15"])
    cases = {"as logged": (0, 1.0), "of the pose before": (-1, 1.0), "of the pose after": (1, 1.0)}
    for name, (shift, scale) in {**cases, "1 % shorter": (0, 0.99), "1 % longer": (0, 1.01)}.items():
        cells = []
        for number in (14, 15):
            graph, values = goats(data, number, "fixed")
            pose = graph.factors[1].keys[0].numbers + shift
            ranges = graph.factors[1][np.isin(pose, values.stack("A").numbers)]
            keys = [A[ranges.keys[0].numbers + shift], ranges.keys[1]]
            other = FactorGraph([graph.factors[0], replaced(ranges, keys, scale * ranges.z)], graph.fixed)
            scales = solve(other, values, Method(CAUCHY, "kinds")).scales
            assert scales is not None
            cells.append(f"{scales.components[1].scale:.2f} ± {scales.components[1].sigma:.2f}")
        table.add(name, *cells)
    return table


def rms(a: Array) -> float:
    return float(np.sqrt(np.square(a).mean()))


def lagged(r: Array, beacon: npt.NDArray[np.int64], right: Mask, lag: int) -> float:
    """Correlation of residuals of one beacon so many measurements apart, mean of the beacons."""
    own = [r[(beacon == k) & right] for k in np.unique(beacon)]
    return float(np.mean([np.corrcoef(e[:-lag], e[lag:])[0, 1] for e in own]))


def twin(solution: Solution, stated: FactorGraph, rng: np.random.Generator) -> FactorGraph:
    """The measurements of a vehicle that is where the solution is, with independent errors of its sigmas."""
    factors = []
    for factor, noisy in zip(stated.factors, solution.graph.factors, strict=True):
        model, X = solution.values.gather(noisy)
        h, _ = factor.predict(model.manifolds, *X)
        W = model.W if model.W.ndim == 3 else np.eye(model.dim) * model.W[:, None, :]
        e = np.linalg.solve(
            np.broadcast_to(W, (len(factor), *W.shape[1:])), rng.normal(size=(len(factor), model.dim, 1))
        )
        factors.append(replaced(factor, z=model.space.retract(h, e[..., 0])))
    return FactorGraph(factors, stated.fixed)


def twins(data: Path, kept: dict[tuple[int, str], Solution], seeds: int) -> list[str]:
    """Mean NEES over simulated twins, with stated and with estimated sigmas."""
    low, high = nees_bounds(2, seeds)
    table = Table(["twin of", "stated", "estimate", "estimate:units", f"bounds of {seeds} runs"])
    for (number, beacons), solution in kept.items():
        stated, _ = goats(data, number, beacons)
        cells = []
        for groups in (None, "kinds", "units"):
            means = []
            for seed in range(seeds):
                graph = twin(solution, stated, np.random.default_rng([number, BEACONS.index(beacons), seed]))
                solved = solve_from(graph, solution.values, groups)
                means.append(judged(solved, solution.values, "A").nees.mean())
            cells.append(f"{np.mean(means):.3g}")
        table.add(f"GOATS {number}, beacons {beacons}", *cells, f"{low:.2f} to {high:.2f}")
    return table


# --- logs with fair sigmas --------------------------------------------------------------------------------------------


def others(data: Path) -> list[str]:
    """plaza2 and Victoria Park."""
    titles = ["log", "sigmas", "kernel", "chi2", "degrees of freedom", "rigid ATE", "NEES", "scales"]
    table = Table(titles, "lllrrrrl")
    graph, truth, _ = nls.load(data / "range-only" / "plaza2.pyfg.gz")
    for kernel, groups in ((None, None), (None, "kinds"), (None, "units"), (CAUCHY, None), (CAUCHY, "kinds")):
        solution = solve(graph, truth, method := Method(kernel, groups))
        judgement, result = judged(solution, truth, "A"), solution.graph.optimize(solution.values)
        cells = ["plaza2", method, f"{result.chi2_final:.5g}", result.dof, f"{judgement.rigid:.3f}"]
        table.add(*cells, f"{judgement.nees.mean():.3g}", solution.scale_text)
    park = victoria_park(read_victoria_park(data / "victoria-park"))
    ekf = EKF(associate=Nearest(0.99))
    track = ekf.run(park.graph, park.start)
    graph, start = park.named(ekf.associations, track.X)
    values = graph.optimize(start).values
    graph, start = park.named(park.again(values), values[x])
    for groups in (None, "kinds"):
        solution = solve_from(graph, start, groups)
        result, error = solution.result, park.gps_error(solution.values[x]).rmse
        cells = ["Victoria Park", Method(None, groups), f"{result.chi2_final:.5g}", result.dof]
        table.add(*cells, f"{error:.3f} | | {solution.scale_text}")
    return table


def page(data: Path, seeds: int) -> Sequence[str]:
    """The lines of the page."""
    tables, kept = goats_tables(data)
    count = len(kept[14, "fixed"].values.stack("A")) - 1
    low, high = nees_bounds(2, 1)
    all_low, all_high = nees_bounds(2, count)
    return [
        "`nls solve --sigmas estimate` finds one scale on the stated sigmas of every kind of measurement. "
        "`estimate:units` finds one for the lengths and one for the angles of a kind. Both use the residuals "
        "alone. The truth is used only in the columns that compare with it.",
        "## GOATS: an AUV among four acoustic beacons",
        "- The files state 2 cm and 2 mrad for a step of dead reckoning and 0.75 m for a range.",
        "- Truth: the vertices of the file, as its source states.",
        f"- Beacons are fixed at their places in the file, have priors of {SURVEYED:g} m there, or are unknown. The "
        "priors are a kind of their own with an estimated scale.",
        "- With unknown beacons the first pose is fixed at its place in the file. Errors are relative to this pose.",
        "- ATE is not aligned. Sigma: rms over the poses of the standard deviation of the position. Lengths are in m.",
        "- NEES: mean over the poses of e' P^-1 e of the position, expectation 2. Of single poses 95 % are within "
        f"{low:.2f} to {high:.2f}.",
        f"- With independent errors the mean over {count} poses would be within {all_low:.2f} to {all_high:.2f}. "
        "Errors along a track are not independent.",
        "- *Inside 95 %*: poses whose truth is within the ellipse of 95 %.",
        f"- Kernels: {HUBER}, {CAUCHY}.",
        *tables,
        "Estimation lowers the NEES by one to three orders of magnitude.",
        "- GOATS 15 ends at 2.2 to 3.0 where the places of the beacons are measurements with an estimated scale, not "
        "fixed. Of the poses, 85 to 94 % are inside their ellipse.",
        "- With unknown beacons, `estimate:units` and a kernel, both logs are inside the bounds of a single pose. "
        "The test is weak: 67 to 69 % of the poses are inside their ellipse.",
        "- Above the bounds are both logs with fixed beacons, and GOATS 14 with priors.",
        "- Without a kernel, outliers decide the scale. A dozen ranges of beacon 3 of GOATS 14 are up to 200 m wrong. "
        "Sigmas that cover these are too large for the rest.",
        "The remaining error is not a wrong scale:",
        *reasons(data, kept),
        "- Residuals are in the units of the measurement, without ranges that are 15 m off at the solution. The "
        "solution: Cauchy, `estimate:units`, beacons fixed.",
        "- Lag: correlation of the residuals at the truth of one beacon, 1 and 10 of its ranges apart.",
        "Ranges and steps fit the solution better than the truth. Steps of the truth differ from dead reckoning by "
        "more than a meter each. So the truth of these files is probably another estimate, meters away from the log. "
        "Its range errors differ between beacons and are correlated over several ranges. Every model here assumes "
        "independent errors: its sigmas shrink with the number of ranges, correlated errors do not. No scale corrects "
        "this, and none was tuned to the truth.",
        "Neither a delay of the pings nor a speed of sound that is 1 % wrong is the reason. The ranges as logged need "
        "the smallest scale. Scale of the ranges, Cauchy, beacons fixed:",
        *controls(data),
        "### Simulated twins",
        "Same geometry and same stated sigmas as in the file. The errors are independent and have the estimated "
        "sigmas (Cauchy, `estimate:units`). Mean NEES of the positions; bounds as for one pose a run.",
        *twins(data, kept, seeds),
        "If errors follow the model, covariances are right with a scale for each unit. One scale a kind keeps the "
        "stated ratio between positions and headings. Here that ratio is wrong by a factor of 20, most so without "
        "known beacons.",
        "## Logs with fair sigmas",
        "plaza2: against RTK GPS. Victoria Park: trees found again as on the page about landmark logs; the error is "
        "the distance of GPS from the track.",
        *others(data),
        "Both tracks get better with estimated sigmas. The NEES of plaza2 gets worse. Its odometry is better than "
        "stated, so the sigmas shrink. Its range errors depend on beacon and distance, so the smaller sigmas are too "
        "small.",
    ]


if __name__ == "__main__":
    make_page("Sigmas estimated from residuals", page, seeds=(20, "simulated twins of a log"))
