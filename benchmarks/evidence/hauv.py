"""What the sonar is worth to a hovering vehicle: drift before and after, and whether the covariances are true.

    python benchmarks/evidence/hauv.py [--seeds 10] [--nees-seeds 100] [--out DIR]

The reference missions `sim.hauv_floor` and `sim.hauv_hull`, seeds 0, 1, 2, ..., with the elevation left free, kept in
the aperture by a hinge, and searched for between pairs of contacts, without landmarks. Nothing is aligned: the first
pose is known.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import radians
from time import process_time

import numpy as np
from script import Table, make_page, spread

import sim
from factors import RangeAzimuth, sonar_factors
from models import SE3
from models.algebra import Array, Mask
from models.chi_squared import chi2_gate
from nls import FactorGraph, GaussNewton, LevenbergMarquardt, Marginals, UnderconstrainedError, Values, kinds
from nls.analysis import landmark_information
from nls.filters.consistency import nees_bounds
from nls.optimizers import Optimizer
from sim.mission import rebuilt

SCENES: dict[str, tuple[Callable[..., sim.Mission], float]] = {
    "floor, +-7 deg": (sim.hauv_floor, 14.0),
    "floor, +-14 deg": (sim.hauv_floor, 28.0),
    "hull, +-7 deg": (sim.hauv_hull, 14.0),
}
CONSISTENCY = ("floor, +-7 deg", "hull, +-7 deg")
TREATMENTS = ("free", "hinge")
SEARCH = "search"  # without landmarks: in the table of drift
ALONE = "free, the others left out"
WELL = 0.05  # m: a landmark whose weak direction, the elevation, is known so well from known poses
x, l = kinds("x", "l")


def mission(scene: str, elevation: str, seed: int) -> sim.Mission:
    """A reference mission."""
    make, aperture = SCENES[scene]
    how = "free" if elevation == SEARCH else elevation
    made = make(np.random.default_rng(seed), aperture=radians(aperture), elevation=how)
    return without_landmarks(made) if elevation == SEARCH else made


def without_landmarks(given: sim.Mission) -> sim.Mission:
    """The mission with its poses only, those that saw the same landmark joined by a factor."""
    pose, target, contacts = *given.contacts.keys[:2], given.contacts
    arcs = sonar_factors(pose, target, contacts.z, contacts.noise, given.sonar, given.offset, elevation=SEARCH)
    poses = Values({x: (SE3, given.start[x])})
    return replace(given, graph=FactorGraph([*given.graph.factors[:4], *arcs]), start=poses, elevation=SEARCH)


# --- drift ------------------------------------------------------------------------------------------------------------


@dataclass
class Solved:
    """One optimizer on one mission: how it ended, and how far the trajectory then is from the truth."""

    status: str
    iterations: int
    ate: float
    seconds: float


def solve(given: sim.Mission, optimizer: Optimizer) -> Solved:
    """Optimize a mission from its start; a system that is singular on the way is a status too."""
    began = process_time()
    try:
        result = given.graph.optimize(given.start, optimizer)
    except UnderconstrainedError:
        return Solved("UNDERCONSTRAINED", 0, float("nan"), process_time() - began)
    return Solved(result.status.name, result.iterations, given.ate(result.values), process_time() - began)


def drift(seeds: int) -> list[str]:
    """A row a scene, a treatment and an optimizer."""
    titles = ["scene", "elevation", "dead reckoning, m", "optimizer", "optimized, m", "better", "iterations", "status"]
    table = Table([*titles, "s"], "llrlrrrlr")
    for scene, elevation in product(SCENES, (*TREATMENTS, SEARCH)):
        given = [mission(scene, elevation, seed) for seed in range(seeds)]
        before = np.array([m.ate(m.start) for m in given])
        for name, optimizer in (("Gauss-Newton", GaussNewton()), ("Levenberg-Marquardt", LevenbergMarquardt())):
            found = [solve(m, optimizer) for m in given]
            better = sum(s.ate < b for s, b in zip(found, before, strict=True))
            status = ", ".join(f"{count} {word}" for word, count in Counter(s.status for s in found).most_common())
            cells = [scene, elevation, spread(before), name, spread(s.ate for s in found), f"{better}/{seeds}"]
            cells += [spread((s.iterations for s in found), 0), status]
            table.add(*cells, f"{np.mean([s.seconds for s in found]):.2f}")
    return table


# --- consistency ------------------------------------------------------------------------------------------------------


@dataclass
class Nees:
    """Normalized squared errors of one mission: of the final pose (6 numbers), of one landmark and of all (3 each)."""

    pose: float
    landmark: float
    all: Array


def nees(given: sim.Mission) -> Nees:
    """e' P^-1 e at the optimum; landmarks are those well observed at the truth, which no noise chooses."""
    values = given.graph.optimize(given.start, LevenbergMarquardt()).values
    marginals = Marginals(given.graph, values)
    well = well_observed(given)
    last = x[given.poses - 1]
    e = SE3.local(values[last][None], given.truth[last][None])[0]
    pose = normalized(e, marginals.covariance(last, frame="body"))
    each = normalized((values[l] - given.truth[l])[well], marginals.all(l)[well])
    return Nees(float(pose), float(each[len(each) // 2]), np.asarray(each))


def well_observed(given: sim.Mission) -> Mask:
    """Which landmarks (n,) are: decided at the truth."""
    return landmark_information(given.sensed, given.truth, l).sigma < WELL


def alone(given: sim.Mission) -> sim.Mission:
    """The mission with its well observed landmarks only."""
    of = given.truth.stack("l").index(given.contacts.keys[1])
    kept = well_observed(given)[of]
    contacts = given.contacts[kept]
    assert isinstance(contacts, RangeAzimuth)
    return rebuilt(given, contacts=contacts, wrong=given.wrong[kept])


def normalized(e: Array, P: Array) -> Array:
    """e' P^-1 e of errors (..., d) and covariances (..., d, d)."""
    return np.asarray(np.sum(e * np.linalg.solve(P, e[..., None])[..., 0], axis=-1))


def clustered_error(each: list[Array]) -> float:
    """Standard error of the mean of numbers that hang together within a seed, given seed by seed."""
    n, total = np.array([len(e) for e in each]), np.array([e.sum() for e in each])
    return float(np.sqrt(np.square(total - n * total.sum() / n.sum()).sum()) / n.sum())


def consistency(seeds: range) -> list[str]:
    """A section with a row a scene and a treatment."""
    pose, point = nees_bounds(6, len(seeds)), nees_bounds(3, len(seeds))
    titles = ["scene", "elevation", f"final pose, expected 6 in {pose[0]:.2f}-{pose[1]:.2f}"]
    titles += [f"one landmark a seed, expected 3 in {point[0]:.2f}-{point[1]:.2f}"]
    lines = Table([*titles, "all well observed, and how many; expected 3", "of them beyond 95 %"], names=2)
    for scene, elevation in product(CONSISTENCY, (*TREATMENTS, ALONE)):
        given = (mission(scene, elevation.split(",")[0], seed) for seed in seeds)
        found = [nees(alone(m) if elevation == ALONE else m) for m in given]
        each = np.concatenate([f.all for f in found])
        said = []
        for mean, (low, high) in (
            (np.mean([f.pose for f in found]), pose),
            (np.mean([f.landmark for f in found]), point),
        ):
            said.append(f"{mean:.2f}{'' if low <= mean <= high else ' **outside**'}")
        half = 1.96 * clustered_error([f.all for f in found])
        outside = "" if abs(each.mean() - 3) <= half else " **outside**"
        beyond = 100 * np.mean(each > chi2_gate(3, 0.95))
        lines.add(scene, elevation, *said, f"{each.mean():.2f} +- {half:.2f} ({len(each)}){outside}", f"{beyond:.1f} %")
    return [f"## Consistency, seeds {seeds[0]} to {seeds[-1]}, Levenberg-Marquardt", *lines]


# --- command line -----------------------------------------------------------------------------------------------------


def page(seeds: int, nees_seeds: int) -> list[str]:
    """The page."""
    floor, hull = mission("floor, +-7 deg", "hinge", 0), mission("hull, +-7 deg", "hinge", 0)
    return [
        f"- {floor.poses} poses and {floor.distance:.0f} m over the floor, "
        f"{hull.poses} poses and {hull.distance:.0f} m along the hull",
        f"## Drift, seeds 0 to {seeds - 1}",
        *drift(seeds),
        "- Absolute trajectory error: rmse of positions, nothing aligned; mean over the seeds, and least and most.",
        "- Better: seeds whose optimized trajectory is nearer to the truth than dead reckoning. s: processor time "
        "of a solve.",
        *consistency(range(nees_seeds)),
        *consistency(range(nees_seeds, 2 * nees_seeds)),
        "- NEES: e' P^-1 e with the error e and the covariance P at the optimum. Its mean should lie within the 95 "
        "% bounds.",
        f"- Well observed: landmarks with a standard deviation below {WELL:g} m along the weak direction, with the "
        "poses known, at the truth.",
        "- All landmarks of one seed have the errors of the poses. So the bounds are for one landmark a seed, the "
        "middle one.",
        "- The mean of all landmarks has 1.96 standard errors from the spread between the seeds. This interval says "
        "more than the bounds.",
        "- On the hull many landmarks have an elevation known to decimeters only. The sonar equation is not linear "
        "over such distances, and no covariance includes the effect on the poses. Rows without these landmarks show "
        "how large it is.",
        "- With the hinge, landmarks are more accurate than their covariances: a covariance counts only active hinges.",
    ]


if __name__ == "__main__":
    counts = {"seeds": (10, "of the table of drift"), "nees_seeds": (100, "of a table of consistency")}
    make_page("A hovering vehicle with an imaging sonar", page, **counts)
