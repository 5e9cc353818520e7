"""Scan matching in simulated harbors: how far from the truth, which closures are right, and do the covariances hold?

    python benchmarks/evidence/harbor.py [--seeds 20] [--images 1] [--workers 2] [--out DIR]

Harbors are `sim.harbor` with 160 keyframes in two laps; seeds 0, 1, 2, ...
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial import cKDTree
from script import make_page, markdown, pooled, spread, timed

import sim
from models import SE2
from models.algebra import Array, Mask, wrap
from nls import Marginals, kinds
from nls.missions.scans import Closing, Field, Matches, Verdict, close, dead_reckoning, submap
from nls.missions.scans.closing import verdicts
from nls.missions.scans.correlation import match_submap
from nls.missions.scans.scans import SUBMAP_HALF, centers, in_world, pairs

GEOMETRIES = ("marina", "quay", "rocks")
KEYFRAMES = 160  # of a harbor: twenty of each geometry in half an hour of one core
AWAY, TURNED = 3.0, np.radians(5.0)  # m, rad: a closure beyond is wrong
PAIRS = 8  # of submaps a seed
GUESSES = {"6 m, 6 deg": (6.0, np.radians(6.0)), "1 m, 2 deg": (1.0, np.radians(2.0))}
WINDOW = {"6 m, 6 deg": (6.0, np.radians(6.0)), "1 m, 2 deg": (3.0, np.radians(3.0))}  # least of `close`
REACH, STEPS = 5.0, 50  # m, pairs of points at most; iterations
x = kinds("x")[0]


# --- the whole: closures and map --------------------------------------------------------------------------------------


def closed(world: sim.Harbor) -> tuple[Closing, float]:
    """The map of a harbor, and the processor time it took, s."""
    return timed(lambda: close(*dead_reckoning(world.poses), world.scans))


def judged(world: sim.Harbor, matches: Matches) -> tuple[Array, Array]:
    """Which matches are at the right place (n,), and which have the right heading, too (n,)."""
    e = world.errors(matches.i, matches.j, matches.pose)
    near = np.hypot(e[:, 0], e[:, 1]) <= AWAY
    return near, near & (np.abs(e[:, 2]) <= TURNED)


def nees(world: sim.Harbor, closing: Closing) -> float:
    """Mean of e' P^-1 e of the positions of all keyframes but the first."""
    P = Marginals(closing.graph, closing.values).all(x, frame="world")[1:, :2, :2]
    e = (closing.values[x] - world.truth)[1:, :2]
    return float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e).mean())


def row_of(world: sim.Harbor, closing: Closing, seconds: float) -> list[float]:
    """Figures of one harbor."""
    m = closing.matches
    place, right = judged(world, m)
    first = closing.rounds[0].matches
    place_1 = judged(world, first)[0]
    figures = [world.ate(world.poses), world.ate(closing.values[x]), len(closing.rounds), len(m)]
    chosen = (m.accepted, m.kept, m.kept & place, m.kept & right, m.accepted & place)
    figures += [*(mask.sum() for mask in chosen), nees(world, closing), seconds]
    return [*figures, (first.kept & ~place_1).sum(), *np.bincount(m.verdict, minlength=len(Verdict))]


def share(part: float, whole: float) -> str:
    """In per cent."""
    return f"{100 * part / whole:.1f} %" if whole else "-"


def maps(rows: dict[str, Array]) -> list[str]:
    """The tables of all seeds."""
    table = []
    for geometry, r in rows.items():
        total = r.sum(axis=0)
        cells = [geometry, spread(r[:, 0], 2), spread(r[:, 1], 2), spread(r[:, 2], 0), f"{total[5] / len(r):.0f}"]
        cells += [share(total[a], total[b]) for a, b in ((6, 5), (7, 5), (6, 3))]
        nees = f"{r[:, 9].mean():.2f}, median {np.median(r[:, 9]):.2f}"
        table.append([*cells, f"{total[11]:.0f}", nees, f"{r[:, 10].mean():.0f}"])
    head = ["harbor", "ATE of dead reckoning, m", "ATE closed, m", "rounds", "closures kept", "right place"]
    head += ["and right heading", "recall", "wrong in round 1", "NEES, expected 2", "s"]
    words = ["harbor", *(verdict.name.lower().replace("_", " ") for verdict in Verdict)]
    return [
        "## Maps",
        *markdown(head, table),
        f"- Harbors of {KEYFRAMES} keyframes, 1 m apart, in two laps. Brackets: the least and the most of the seeds.",
        "- ATE: rmse of the keyframes after a rigid motion. s: processor time.",
        f"- Right place: of the closures that the last round kept, those within {AWAY:g} m of the truth. Right "
        f"heading: within {np.degrees(TURNED):g} deg as well.",
        "- Recall: closures kept at the right place, of all candidates.",
        "- Wrong in round 1: closures kept at a wrong place, in all seeds.",
        "- NEES: of the positions of the keyframes. The first keyframe is fixed.",
        "## Verdicts of the last round, a harbor",
        *markdown(words, [[g, *(f"{n:.0f}" for n in r[:, 12:].mean(axis=0))] for g, r in rows.items()]),
    ]


# --- the matcher alone ------------------------------------------------------------------------------------------------


def icp(target: Array, points: Array, guess: Array) -> tuple[Array, Array]:
    """Pose (3,) by iterated closest points, point to point, and its usual covariance s^2 (J'J)^-1 (3, 3)."""
    tree, T = cKDTree(target), guess.copy()
    for _ in range(STEPS):
        q = SE2.act(np.repeat(T[None], len(points), axis=0), points)
        d, nearest = tree.query(q)
        near = d <= REACH
        p, g = points[near], target[nearest[near]]
        if len(p) < 3:
            break
        a, b = p - p.mean(axis=0), g - g.mean(axis=0)
        yaw = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
        c, s = np.cos(yaw), np.sin(yaw)
        new = np.append(g.mean(axis=0) - np.array([[c, -s], [s, c]]) @ p.mean(axis=0), yaw)
        change, T = np.abs(new - T).max(), new
        if change < 1e-5:
            break
    J = np.zeros((len(p), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -p[:, 1], p[:, 0]
    H = np.einsum("nki,nkj->ij", J, J)
    return T, np.linalg.inv(H) * (d[near] ** 2).sum() / (2 * len(p) - 3)


def trials(world: sim.Harbor, poses: Array, guess_of: str) -> list[list[float]]:
    """Matches of random pairs of submaps that overlap, from a random guess: error, mahalanobis, along, ... of both."""
    rng = np.random.default_rng([0 if world.seed is None else world.seed, 7])
    middle = centers(world.scans)
    a, b = pairs(world.truth, world.scans, middle)
    rows = rng.choice(len(a), min(PAIRS, len(a)), replace=False)
    out = []
    for i, j in zip(middle[a[rows]].tolist(), middle[b[rows]].tolist(), strict=True):
        T = SE2.between(world.truth[[i]], world.truth[[j]])[0]
        width, turn = GUESSES[guess_of]
        guess = T + rng.uniform(-1.0, 1.0, 3) * [width, width, turn]
        target, points = (submap(poses, world.scans, k, SUBMAP_HALF) for k in (i, j))
        m = match_submap(Field(target), points, guess, WINDOW[guess_of])
        verdict = verdicts(*(np.array([v]) for v in (m.score, m.ratio, m.edge, m.spread, WINDOW[guess_of][0])))[0]
        figures = [verdict]
        for pose, C in ((m.pose, m.covariance), icp(target, points, guess)):
            e = SE2.between(T[None], pose[None])[0]
            e[2] = wrap(e[2])
            R = SE2.rotation(world.truth[[j]])[0]  # the quay is along x
            world_e, world_C = R @ e[:2], R @ C[:2, :2] @ R.T
            d2 = e @ np.linalg.solve(C, e) / 3
            figures += [np.hypot(*e[:2]), abs(e[2]), d2, *np.abs(world_e), *np.sqrt(np.diag(world_C))]
        out.append(figures)
    return out


def matcher(r: Array) -> list[object]:
    """Cells of one row: of the accepted, and of all, and of ICP."""

    def of(k: Mask, at: int) -> str:
        right = k & (r[:, at] <= AWAY)
        return f"{np.sqrt((r[right, at] ** 2).mean()):.2f}, {r[right, at + 2].mean():.2f}" if right.any() else "-"

    accepted, everything = r[:, 0] == Verdict.ACCEPTED, np.ones(len(r), dtype=bool)
    wrong, icp = r[:, 1] > AWAY, r[:, 8] > AWAY
    cells = [len(r), accepted.sum(), (accepted & wrong).sum(), of(accepted, 1)]
    return [*cells, wrong.sum(), of(everything, 1), icp.sum(), of(everything, 8)]


def matchers(results: dict[tuple[str, str, str], Array]) -> list[str]:
    """The tables of matches alone."""
    head = ["harbor, submaps, guess", "pairs", "accepted", "of them wrong", "rms m, d2/3", "wrong of all"]
    head += ["rms m, d2/3", "ICP wrong", "rms m, d2/3"]
    lines = ["## The matcher alone"]
    lines += markdown(head, [[", ".join(name), *matcher(r)] for name, r in results.items()])
    quays = [
        [
            ", ".join(name[1:]),
            *(f"{np.median(r[:, 6 + at] / r[:, 7 + at]):.1f}" for at in (0, 7)),
            *(f"{np.sqrt(np.mean((r[:, 4 + at] / r[:, 6 + at]) ** 2)):.2f}" for at in (0, 7)),
            *(f"{np.sqrt(np.mean((r[:, 5 + at] / r[:, 7 + at]) ** 2)):.2f}" for at in (0, 7)),
            f"{(r[:, 0] == Verdict.ACCEPTED).sum()}",
        ]
        for name, r in results.items()
        if name[0] == "quay"
    ]
    head = ["submaps, guess", "sigma along over across", "ICP", "error along over its sigma, rms", "ICP"]
    head += ["error across over its sigma, rms", "ICP", "accepted"]
    return [
        *lines,
        f"- Random pairs of submaps of {2 * SUBMAP_HALF + 1} keyframes with overlapping footprints.",
        "- A guess is off by up to the stated width, evenly distributed. The window is as wide, and at least 3 m "
        "and 3 deg.",
        "- Submaps are built from the true poses, or from dead-reckoned poses, which bend them.",
        f"- Wrong: more than {AWAY:g} m off. The rms of the position and the mean of d2/3 are over all other matches.",
        "- d is the error over its covariance (Mahalanobis). A mean d2/3 of 1 means a right covariance, a smaller one "
        "a covariance that is too large.",
        f"- ICP: point to point, pairs up to {REACH:g} m, covariance s^2 (J'J)^-1.",
        "## The straight quay: along and across",
        *markdown(head, quays),
        "The table has all matches, also wrong ones. No feature fixes the position along this wall, so no match "
        "should be accepted.",
    ]


# --- from images ------------------------------------------------------------------------------------------------------


def strays(world: sim.Harbor) -> float:
    """Share of the points farther than 1 m from all walls, piles and rocks."""
    scene, p = world.scene, in_world(world.truth, world.scans)
    a, e = scene.walls[:, 0], scene.walls[:, 1] - scene.walls[:, 0]
    share = np.clip(((p[:, None] - a) * e).sum(axis=2) / (e**2).sum(axis=1), 0, 1)
    d = np.linalg.norm(p[:, None] - a - share[..., None] * e, axis=2).min(axis=1, initial=np.inf)
    if len(scene.piles):
        d = np.minimum(d, (np.linalg.norm(p[:, None] - scene.piles[:, :2], axis=2) - scene.piles[:, 2]).min(axis=1))
    if len(scene.rocks):
        d = np.minimum(d, cKDTree(scene.rocks).query(p)[0])
    return float((d > 1.0).mean())


def from_images(seeds: int) -> list[str]:
    """The chain from the image to the map, beside points that are drawn from their rates."""
    rows = []
    for geometry, seed, source in product(("marina", "rocks"), range(seeds), ("drawn", "images")):
        images = source == "images"
        world, made = timed(sim.harbor, np.random.default_rng(seed), geometry, KEYFRAMES, images=images)
        closing, seconds = closed(world)
        place, kept = judged(world, closing.matches)[0], closing.matches.kept
        cells = [f"{geometry} {seed}, {source}", f"{len(world.scans.points) / len(world.truth):.0f}"]
        cells += [f"{100 * strays(world):.1f} %", *(f"{world.ate(X):.2f}" for X in (world.poses, closing.values[x]))]
        rows.append([*cells, kept.sum(), (kept & ~place).sum(), f"{made:.0f}", f"{seconds:.0f}"])
    head = ["harbor", "points a keyframe", "strays", "ATE reckoned, m", "closed, m", "kept", "of them wrong"]
    return [
        "## From images to the map",
        *markdown([*head, "s for the scans", "s for the map"], rows),
        "- Images have 768 beams by 1,000 bins (`sim.sonar_image`). Detections are by `nls.missions.sonar.detect`, "
        "greatest-of. Their nominal rate of false alarms is that of the drawn points.",
        "- Strays: points more than 1 m from any surface at the true pose.",
    ]


Trials = dict[tuple[str, str, str], list[list[float]]]


def one(geometry: str, seed: int) -> tuple[list[float], Trials]:
    """Figures of a harbor, and trials of the matcher in it."""
    world = sim.harbor(np.random.default_rng(seed), geometry, KEYFRAMES)
    closing, seconds = closed(world)
    figures = row_of(world, closing, seconds)
    print(geometry, seed, " ".join(f"{v:.3g}" for v in figures), flush=True)
    results = {}
    for submaps, poses in (("true", world.truth), ("reckoned", world.poses), ("closed", closing.values[x])):
        for guess in GUESSES if submaps == "true" else list(GUESSES)[:1]:
            results[geometry, submaps, guess] = trials(world, poses, guess)
    return figures, results


def page(seeds: int, images: int, workers: int) -> list[str]:
    """All but the head."""
    calls = [(geometry, seed) for geometry in GEOMETRIES for seed in range(seeds)]
    results = list(pooled(workers, one, *zip(*calls, strict=True)))
    rows = {g: np.array([figures for figures, _ in results[k * seeds :][:seeds]]) for k, g in enumerate(GEOMETRIES)}
    merged: Trials = {}
    for _, trial in results:
        for name, r in trial.items():
            merged.setdefault(name, []).extend(r)
    lines = [*maps(rows), *matchers({name: np.array(r) for name, r in merged.items()})]
    return [*lines, *from_images(images)] if images else lines


if __name__ == "__main__":
    make_page(
        *("Scan matching in simulated harbors, seeds 0 to {last}", page),
        seeds=(20, "harbors of every geometry"),
        images={"type": int, "default": 1, "help": "harbors whose scans come from images (default 1)"},
        workers=(2, "processes"),
    )
