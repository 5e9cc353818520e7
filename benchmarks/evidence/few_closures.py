"""Maps that twenty loop closures hold: how often a right map is doubted, and whether a wrong one is silent.

    LEADLINE_DATA=DIR python benchmarks/evidence/few_closures.py [--mit FILE] [--seeds N] [--names NAME ...]

10 to 60 % of all closures are wrong, of six kinds. --mit is the public graph of the MIT Killian Court (808 poses, 20
closures), MIT.g2o or input_MITb_g2o.g2o, which is not shipped.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from script import make_page, markdown, timed
from wrong_closures import FINE, KINDS, SETS, TWENTY, Solved, X, few, solved, spoiled

import nls
from factors import Between, Diagonal
from models import SE2
from models.algebra import Array
from nls import FactorGraph, Values
from nls.covariance import Marginals
from nls.optimizers import Fit

SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)  # of all closures, right and wrong
PUBLIC = ("CSAIL", "FR079", "INTEL", "intel", "kitti_00")
HALLS = {"halls": 1.0, "halls, poor odometry": 3.0}  # times the noise of odometry
RUNS = ", in two runs"  # of a public graph: what is near each other agrees, and the rest of the map hangs on it
CLEAN = ("kitti_00", "intel", "CSAIL")
SIGMAS = 3.0  # of the position of a pose: a map that is nearer everywhere is the same map within its own sigmas
HALL, CORNERS, POSES, REVISITED = 12, 5, 800, 1.5  # steps of a hall; corners a side; poses; m between two visits


@dataclass(frozen=True)
class Trial:
    """A graph with wrong closures, and what became of it."""

    name: str
    share: float
    right: bool
    doubts: tuple[str, ...]
    sigmas: float
    seconds: float

    @property
    def outcome(self) -> str:
        """``solved``, ``doubted`` and right, ``noticed``, ``within sigmas`` or ``silent``."""
        if self.right:
            return "doubted" if self.doubts else "solved"
        return "noticed" if self.doubts else "within sigmas" if self.sigmas < SIGMAS else "silent"


def halls(path: Path, times: float) -> None:
    """A drive through the halls of a building, 5 x 5 crossings 24 m apart, that twenty closures spread over it hold."""
    rng = np.random.default_rng(0)
    at, heading, pose = np.array([0, 0]), 0, np.zeros(3)
    T, steps = [pose], []
    while len(T) < POSES:
        ways = [h for h in (heading - 1, heading, heading + 1) if _inside(at, h)]
        turn = int(rng.choice(ways)) - heading if ways else 2
        heading += turn
        for k in range(HALL):
            steps.append(SE2.compose(np.array([0, 0, turn * np.pi / 2 if k == 0 else 0.0]), np.array([2.0, 0, 0])))
            T.append(SE2.compose(T[-1], steps[-1]))
        at = at + _way(heading)
    truth, z = np.array(T), np.array(steps)
    sigmas, tight = times * np.array([0.05, 0.03, 0.005]), np.array([0.1, 0.1, 0.02])
    k = np.arange(len(z))
    near = np.linalg.norm(truth[:, None, :2] - truth[None, :, :2], axis=2) < REVISITED
    pairs = np.argwhere(np.triu(near, 60))
    i, j = pairs[np.sort(rng.choice(len(pairs), TWENTY, replace=False))].T
    seen = SE2.compose(SE2.between(truth[i], truth[j]), SE2.exp(tight * rng.normal(size=(TWENTY, 3))))
    z = SE2.compose(z, SE2.exp(sigmas * rng.normal(size=z.shape)))
    (x,) = nls.kinds(X)
    noise = Diagonal(np.concatenate([np.tile(sigmas, (len(z), 1)), np.tile(tight, (TWENTY, 1))]))
    edges = Between(x[np.r_[k, i]], x[np.r_[k + 1, j]], np.concatenate([z, seen]), noise)
    nls.save(path, FactorGraph([edges]), Values({x: (SE2, truth)}))


def _way(heading: int) -> Array:
    return np.array([(1, 0), (0, 1), (-1, 0), (0, -1)][heading % 4])


def _inside(at: Array, heading: int) -> bool:
    return bool(((at + _way(heading) >= 0) & (at + _way(heading) < CORNERS)).all())


def tried(name: str, whole: Solved, share: float, kind: str, seed: int) -> Trial:
    """A trial; public graphs with many closures are left twenty, spread over the drive or in two runs."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind), round(100 * share)])
    right = few(whole, TWENTY, rng, not name.endswith(RUNS)) if whole.loops.sum() > TWENTY else whole
    wrong = spoiled(right, round(share / (1 - share) * TWENTY), kind, rng)
    found, seconds = timed(nls.gnc, FactorGraph([right.edges, wrong]), right.start)
    values = found.result.values
    doubts = tuple(doubt.kind.name for doubt in found.doubts)
    fine = right.off(values) < FINE
    sigmas = 0.0 if fine or doubts else farthest(found.graph, values, right.best)
    trial = Trial(name, share, fine, doubts, sigmas, seconds)
    if trial.outcome in ("silent", "within sigmas"):
        where = f"{name} {share} {kind} {seed}"
        print(f"{trial.outcome}: {where}: {right.off(values):.4f}, {sigmas:.2f} sigmas", flush=True)
    return trial


def farthest(graph: FactorGraph, values: Values, right: Values) -> float:
    """The largest distance of a position from the right one, in its sigmas; the first pose is held."""
    (x,) = nls.kinds(X)
    Sigma, r = Marginals(graph, values).all(x, view="position")[1:], 2
    away = (values.stack(X).X - right.stack(X).X)[1:, :r]
    return float(np.sqrt((away * np.linalg.solve(Sigma, away[..., None])[..., 0]).sum(axis=1).max()))


def counted(trials: list[Trial]) -> list[int]:
    """Right and not doubted, right and doubted, wrong and noticed, within sigmas, silent."""
    outcomes = [trial.outcome for trial in trials]
    return [outcomes.count(o) for o in ("solved", "doubted", "noticed", "within sigmas", "silent")]


def rates(trials: list[Trial]) -> str:
    """Percent of right maps that are doubted."""
    right = [trial for trial in trials if trial.right]
    return f"{100 * np.mean([bool(trial.doubts) for trial in right]):.0f} %" if right else ""


def tables(trials: list[Trial], clean: list[str]) -> list[str]:
    """The page below its head."""
    heads = ("right", "right, doubted", "wrong, noticed", "wrong, within its sigmas", "wrong, silent", "right doubted")
    every, names = trials, list(dict.fromkeys(trial.name for trial in trials))
    trials = [trial for trial in every if not trial.name.endswith(RUNS)]
    of_name = {name: [t for t in every if t.name == name] for name in names}
    by_name = [(name, ts) for name, ts in of_name.items() if not name.endswith(RUNS)]
    in_runs = [(name, ts) for name, ts in of_name.items() if name.endswith(RUNS)]
    in_runs.append(("**all**", [trial for _, ts in in_runs for trial in ts]))
    by_share = [(f"{100 * share:.0f} %", [t for t in trials if t.share == share]) for share in SHARES]
    kinds = sorted({doubt for t in trials if t.right for doubt in t.doubts})
    why = [[k, sum(t.right and k in t.doubts for t in trials)] for k in kinds]
    seconds = np.median([t.seconds for t in trials])
    return [
        f"- {len(every)} trials, median {seconds:.1f} s of processor time; 10 to 60 % of all closures are wrong",
        f"- *right*: within {100 * FINE:g} % of the extent of the optimum without wrong closures",
        f"- *within its sigmas*: not right and without a doubt, but every pose is within {SIGMAS:g} of its sigmas",
        *markdown(("graph", *heads), [[n, *counted(ts), rates(ts)] for n, ts in [*by_name, ("**all**", trials)]]),
        "",
        *markdown(("wrong closures", *heads), [[n, *counted(ts), rates(ts)] for n, ts in by_share]),
        "Doubts stated on right maps; some maps have two:",
        *markdown(("doubt", "right maps"), why),
        "Twenty closures in two runs of ten: they fix two places, and the rest of the map depends on them.",
        *markdown(("graph", *heads), [[n, *counted(ts), rates(ts)] for n, ts in in_runs]),
        "With all closures of the graph and no wrong ones:",
        *clean,
    ]


def controls(data: Path) -> list[str]:
    """Graphs without wrong closures: what gnc states of them."""
    rows = []
    for name in CLEAN:
        graph, values, _ = nls.load(data / SETS[name])
        found = nls.gnc(graph, values)
        plausible = "yes" if found.result.fit is Fit.PLAUSIBLE else "no"
        doubts = ", ".join(doubt.kind.name for doubt in found.doubts) or "none"
        rows.append([name, found.doubted, len(found.rejected), doubts, plausible])
    return markdown(("graph", "closures", "rejected", "doubts", "chi2 plausible"), rows)


def page(data: Path, mit: Path | None, seeds: int, names: list[str]) -> list[str]:
    """All trials, and their tables."""
    trials: list[Trial] = []
    with TemporaryDirectory() as folder:
        graphs = {"MIT": solved(mit)} if mit else {}
        for name in names:
            path = Path(folder) / f"{len(graphs)}.g2o"
            if name in HALLS:
                halls(path, HALLS[name])
            graphs[name] = solved(path if name in HALLS else data / SETS[name.removesuffix(RUNS)])
        for name, whole in graphs.items():
            for (number, share), seed in product(enumerate(SHARES), range(seeds)):
                turn = list(KINDS)[(seed + number) % len(KINDS)]
                trials += [tried(name, whole, share, kind, seed) for kind in (KINDS if name == "MIT" else [turn])]
            print(name, *counted([t for t in trials if t.name == name]), flush=True)
    return tables(trials, controls(data))


if __name__ == "__main__":
    graphs = [*HALLS, *PUBLIC, *(name + RUNS for name in PUBLIC)]
    make_page(
        "Maps with twenty loop closures",
        page,
        mit={"type": Path, "metavar": "FILE", "help": "the graph of the MIT Killian Court"},
        seeds=(5, "trials of every share"),
        names={"nargs": "*", "default": graphs, "help": "graphs (default: all)"},
    )
