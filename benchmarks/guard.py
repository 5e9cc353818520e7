"""The regression guard: what a piece of the library costs, over what a reference computation costs beside it.

    python benchmarks/guard.py [--update] [--baselines FILE] [--seconds 2] [--only NAME ...]

Both are timed in turn, many times, in one process with one BLAS thread; the smallest processor times are compared. Such
ratios stay the same where times do not: on a busy machine, and much the same on another one. A ratio that exceeds its
baseline by half is measured again; when it does so again it is named, and the exit status is 1. --update writes the
ratios of this run as the new baselines.
"""

from __future__ import annotations

import os

ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "BLIS", "OMP")}
os.environ.update(ONE_THREAD)  # before NumPy is imported

import argparse  # noqa: E402
import json  # noqa: E402
import resource  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402
from time import process_time  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from pinv import machine, positive  # noqa: E402 - the script beside this one

BASELINES = Path(__file__).parent / "baselines.json"
ROOT = Path(__file__).parents[1]
ALLOWED = 1.5  # times its baseline
LEAST = 5  # rounds of a ratio
TO_SOLVE = "import nls; nls.load, nls.initialize, nls.FactorGraph, nls.Cholesky"  # they are imported when first used

Work = Callable[[], object]
Pair = tuple[Work, Work]  # ours, the reference


# --- the pieces -------------------------------------------------------------------------------------------------------


class Piece:
    """A world with all the intermediate results that a piece or a reference starts from.

    Parameters
    ----------
    make : the simulated world, from a seed.
    """

    def __init__(self, make: Callable[[np.random.Generator], Any]) -> None:
        from nls.gauge import choose_gauge, fixed_variables
        from nls.linear import default_solver
        from nls.sparse.pattern import Pattern

        self.world = make(np.random.default_rng(1))
        graph, values = self.world.graph, self.world.truth
        pattern = Pattern(graph.factors, values)
        self.held = choose_gauge("first", pattern, values, fixed_variables(graph.fixed, values)).held
        self.pattern = pattern.holding(self.held)
        from nls.system import LinearSystem

        self.system = LinearSystem.at(self.pattern, self.world.truth)
        self.state, self.S = default_solver().analyze(self.pattern).factorization, self.system.H_blocks
        self.H = self.state.hessian.matrix(self.S)  # lower triangle, in the order of elimination
        self.A = sp.csc_array(self.system.A)
        self.edges = len(self.world.graph)

    def build(self) -> object:
        from nls.sparse.pattern import Pattern

        return Pattern(self.world.graph.factors, self.world.truth, self.held).blocks

    def analyze(self) -> object:
        from nls.sparse.hessian import Hessian

        blocks = self.pattern.blocks
        hessian = Hessian(self.state.hessian.elimination, blocks.dims, blocks.diagonal, blocks.off)  # none that is kept
        return type(self.state.decomposition)(hessian)

    def linearize(self) -> object:
        from nls.system import LinearSystem

        return LinearSystem.at(self.pattern, self.world.truth)

    def assemble(self) -> object:
        return self.state.hessian.data(self.pattern.blocks.fill(self.system.blocks))

    def factorize(self) -> object:
        return self.state.factorize(self.S)

    def chordal(self) -> object:
        import nls

        return nls.initialize(self.world.graph, self.world.start, "chordal")

    def optimize(self) -> object:
        return self.world.graph.optimize(self.world.truth)

    def marginals(self) -> object:
        import nls

        return nls.Marginals(self.world.graph, self.world.truth).all(nls.Kind("x"), "body")


class Reference:
    """Computations of the same kind by NumPy, SciPy and CHOLMOD alone."""

    def __init__(self, piece: Piece) -> None:
        from nls.linear.cholesky import cholmod

        self.piece, self.cholmod = piece, cholmod()
        assert self.cholmod is not None
        self.factor = self.cholmod.analyze(piece.H, mode="auto", ordering_method="natural")
        d = int(piece.pattern.dims[0])
        rng = np.random.default_rng(0)
        self.M, self.N = rng.normal(size=(2, piece.edges, d, d))
        self.index = rng.integers(0, len(piece.world.truth), piece.edges)
        self.rhs = rng.normal(size=(piece.pattern.n, 60))

    def sorts(self) -> object:
        """As many random numbers as edges, sorted, counted and summed."""
        order = np.argsort(self.index, kind="stable")
        return np.cumsum(np.bincount(self.index[order]))

    def products(self) -> object:
        """Ten products of stacks, a block an edge."""
        for _ in range(10):
            out = self.M @ self.N
        return out

    def scipy_gram(self) -> object:
        return self.piece.A.T @ self.piece.A

    def analysis(self) -> object:
        """CHOLMOD's own ordering and analysis of all scalars."""
        return self.cholmod.analyze(self.piece.H, mode="auto", ordering_method="amd")

    def factorization(self) -> object:
        """CHOLMOD's numeric factorization of the same matrix in the same order."""
        from nls.sparse.threads import single_thread

        with single_thread():
            return self.factor.cholesky_inplace(self.piece.H)

    def iteration(self) -> object:
        """One Gauss-Newton iteration without a library: A'A, analysis, factorization, one solve."""
        self.scipy_gram()
        self.analysis()
        self.factorization()
        return self.factor.solve_A(self.rhs[:, 0])

    def columns(self) -> object:
        """A factorization and 60 columns of the inverse."""
        self.factorization()
        return self.factor.solve_A(self.rhs)


def pieces(folder: Path) -> dict[str, Pair]:
    """Every ratio by name: ours, and the reference."""
    import nls
    import sim

    plane = Piece(lambda rng: sim.manhattan(rng, n_poses=4000))
    space = Piece(lambda rng: sim.sphere(rng, rings=40, per_ring=40))
    in_plane, in_space = Reference(plane), Reference(space)
    file = folder / "graph.g2o"
    nls.save(file, plane.world.graph, plane.world.start)

    def words() -> object:
        """The words of the file, those that are numbers converted."""
        return np.array([word for word in file.read_bytes().split() if word[0] < 65]).astype(float)

    return {
        "read": (lambda: nls.load(file), words),
        "build": (plane.build, in_plane.sorts),
        "analyze": (plane.analyze, in_plane.analysis),
        "linearize SE2": (plane.linearize, in_plane.products),
        "linearize SE3": (space.linearize, in_space.products),
        "assemble": (plane.assemble, in_plane.scipy_gram),
        "factorize": (space.factorize, in_space.factorization),
        "chordal start": (space.chordal, in_space.iteration),
        "solve in the plane": (plane.optimize, in_plane.iteration),
        "solve in space": (space.optimize, in_space.iteration),
        "marginals": (space.marginals, in_space.columns),
    }


def start_up(statement: str) -> float:
    """Processor time of a fresh Python that runs a statement, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", statement], cwd=ROOT, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


# --- the measurement --------------------------------------------------------------------------------------------------


def timed(work: Work) -> float:
    """Processor time of one run, s."""
    began = process_time()
    work()
    return process_time() - began


def ratio(ours: Callable[[], float], reference: Callable[[], float], seconds: float) -> tuple[float, float, int]:
    """Least time of ours over least time of the reference, run in turn; the least time of ours; rounds."""
    a, b = [ours()], [reference()]  # the first runs load what is loaded late
    rounds, spent = 0, 0.0
    while rounds < LEAST or spent < seconds:
        a.append(ours())
        b.append(reference())
        spent += a[-1] + b[-1]
        rounds += 1
    return min(a) / min(b), min(a), rounds


def measurements(folder: Path) -> dict[str, tuple[Callable[[], float], Callable[[], float]]]:
    """All ratios by name: two clocks each."""
    both = {
        name: (lambda ours=ours: timed(ours), lambda reference=reference: timed(reference))
        for name, (ours, reference) in pieces(folder).items()
    }
    for name, statement in (("import nls", "import nls"), ("import to solve", TO_SOLVE)):
        both[name] = (lambda ours=statement: start_up(ours), lambda: start_up("import numpy, scipy.sparse"))
    return both


# --- command line -----------------------------------------------------------------------------------------------------


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--update", action="store_true", help="write the ratios of this run as the new baselines")
    parser.add_argument("--baselines", type=Path, default=BASELINES, metavar="FILE", help="default beside this script")
    parser.add_argument("--seconds", type=positive, default=2.0, help="processor time for one ratio")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these ratios alone")
    options = parser.parse_args()
    from nls.linear import Cholesky

    if (why := Cholesky.missing()) is not None:
        print(f"guard: the references need CHOLMOD: {why}", file=sys.stderr)
        return 2
    if options.update and options.only:
        parser.error("--update needs all ratios: leave out --only")
    baselines: dict[str, float] = {}
    if not options.update:
        if not options.baselines.exists():
            parser.error(f"{options.baselines} does not exist: make it with --update")
        baselines = json.loads(options.baselines.read_text())["ratios"]
    head = machine()
    with tempfile.TemporaryDirectory() as folder:
        measured = measurements(Path(folder))
        if unknown := set(options.only or ()) - set(measured):
            parser.error(f"no ratio {', '.join(sorted(unknown))}; there are {', '.join(measured)}")
        found, over = {}, []
        print(f"{'ours / reference':20s}{'ratio':>8s}{'baseline':>10s}{'ours, ms':>10s}{'rounds':>8s}")
        for name in options.only or measured:
            found[name], least, rounds = ratio(*measured[name], options.seconds)
            baseline = baselines.get(name)
            if baseline is not None and found[name] > ALLOWED * baseline:
                again, least, rounds = ratio(*measured[name], 2 * options.seconds)
                found[name] = min(found[name], again)
                if found[name] > ALLOWED * baseline:
                    over.append(f"{name}: {found[name]:.3g}, {found[name] / baseline:.1f} times its {baseline:.3g}")
            said = f"{baseline:.3g}" if baseline is not None else "none"
            print(f"{name:20s}{found[name]:8.3g}{said:>10s}{1e3 * least:10.2f}{rounds:8d}", flush=True)
    if options.update:
        record = {"machine": [line.removeprefix("- ") for line in head], "ratios": found}
        options.baselines.write_text(json.dumps(record, indent=1) + "\n")
        print(f"written: {options.baselines}")
        return 0
    if unnamed := [name for name in found if name not in baselines]:
        over.append(f"no baseline for {', '.join(unnamed)}: make them with --update")
    for line in over:
        print(f"guard: {line}", file=sys.stderr)
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main())
