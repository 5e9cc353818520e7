"""The regression guard: what a piece of the library costs, over what a reference computation costs beside it.

    python benchmarks/guard.py [--update] [--baselines FILE] [--seconds 2] [--only NAME ...]

How they are compared: benchmarks/gate.py.
"""

from __future__ import annotations

import os

ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "BLIS", "OMP")}
os.environ.update(ONE_THREAD)  # before NumPy is imported

import argparse  # noqa: E402
import resource  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from gate import Clock, add_options, gate, refuse, stopwatch  # noqa: E402 - the script beside this one

import nls  # noqa: E402
import sim  # noqa: E402
from nls.gauge import choose_gauge, fixed_variables  # noqa: E402
from nls.linear import Cholesky, default_solver  # noqa: E402
from nls.linear.cholesky import cholmod  # noqa: E402
from nls.sparse.hessian import Hessian  # noqa: E402
from nls.sparse.pattern import Pattern  # noqa: E402
from nls.sparse.threads import single_thread  # noqa: E402
from nls.system import LinearSystem  # noqa: E402

BASELINES = Path(__file__).parent / "baselines.json"
ROOT = Path(__file__).parents[1]
TO_SOLVE = "import nls; nls.load, nls.initialize, nls.FactorGraph, nls.Cholesky"  # they are imported when first used

Work = Callable[[], object]
Pair = tuple[Work, Work]  # ours, the reference


# --- the pieces -------------------------------------------------------------------------------------------------------


class Piece:
    """A world (graph, truth, start) with all the intermediate results that a piece or a reference starts from."""

    def __init__(self, world: Any) -> None:
        self.world, graph, values = world, world.graph, world.truth
        pattern = Pattern(graph.factors, values)
        self.held = choose_gauge("first", pattern, values, fixed_variables(graph.fixed, values)).held
        self.pattern = pattern.holding(self.held)
        self.system = LinearSystem.at(self.pattern, self.world.truth)
        self.state, self.S = default_solver().analyze(self.pattern).factorization, self.system.H_blocks
        hessian = self.state.hessian
        self.H = hessian.matrix(hessian.data(self.S))  # lower triangle, in the order of elimination
        self.A = sp.csc_array(self.system.A)
        self.edges = len(self.world.graph)

    def build(self) -> object:
        return Pattern(self.world.graph.factors, self.world.truth, self.held).blocks

    def analyze(self) -> object:
        blocks = self.pattern.blocks
        hessian = Hessian(self.state.hessian.elimination, blocks.dims, blocks.diagonal, blocks.off)  # none that is kept
        return type(self.state.decomposition)(hessian)

    def linearize(self) -> object:
        return LinearSystem.at(self.pattern, self.world.truth)

    def assemble(self) -> object:
        return self.state.hessian.data(self.pattern.blocks.fill(self.system.blocks))

    def factorize(self) -> object:
        return self.state.factorize(self.S)

    def chordal(self) -> object:
        return nls.initialize(self.world.graph, self.world.start, "chordal")

    def optimize(self) -> object:
        return self.world.graph.optimize(self.world.truth)

    def marginals(self) -> object:
        return nls.Marginals(self.world.graph, self.world.truth).all(nls.Kind("x"), "body")


class Reference:
    """Computations of the same kind by NumPy, SciPy and CHOLMOD alone."""

    def __init__(self, piece: Piece) -> None:
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
        """Two products of stacks, a block an edge, and 50 passes over nine numbers an edge: as in a linearization."""
        for _ in range(2):
            out = self.M @ self.N
        x = np.ascontiguousarray(self.M.reshape(len(self.M), -1)[:, :9].T)
        for _ in range(50):
            x = x * x + 0.1
            x /= x.max()
        return out, x

    def scipy_gram(self) -> object:
        return self.piece.A.T @ self.piece.A

    def analysis(self) -> object:
        """CHOLMOD's own ordering and analysis of all scalars."""
        return self.cholmod.analyze(self.piece.H, mode="auto", ordering_method="amd")

    def factorization(self) -> object:
        """CHOLMOD's numeric factorization of the same matrix in the same order."""
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
    plane = Piece(sim.manhattan(np.random.default_rng(1), n_poses=4000))
    space = Piece(sim.sphere(np.random.default_rng(1), rings=40, per_ring=40))
    in_plane, in_space = Reference(plane), Reference(space)
    file = folder / "graph.g2o"
    nls.save(file, plane.world.graph, plane.world.start)

    return {
        "read": (lambda: nls.load(file), lambda: words(file)),
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


def words(file: Path) -> object:
    """The words of a file, those that are numbers converted."""
    return np.array([word for word in file.read_bytes().split() if word[0] < 65]).astype(float)


def start_up(statement: str) -> float:
    """Processor time of a fresh Python that runs a statement, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", statement], cwd=ROOT, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measurements(folder: Path) -> dict[str, tuple[Clock, Clock]]:
    """All ratios by name: two clocks each."""
    both = {name: (stopwatch(ours), stopwatch(reference)) for name, (ours, reference) in pieces(folder).items()}
    for name, statement in (("import nls", "import nls"), ("import to solve", TO_SOLVE)):
        both[name] = (lambda ours=statement: start_up(ours), lambda: start_up("import numpy, scipy.sparse"))
    return both


# --- command line -----------------------------------------------------------------------------------------------------


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_options(parser, BASELINES)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these ratios alone")
    options = parser.parse_args()
    if (why := Cholesky.missing()) is not None:
        print(f"guard: the references need CHOLMOD: {why}", file=sys.stderr)
        return 2
    refuse(parser, options, bool(options.only))
    with tempfile.TemporaryDirectory() as folder:
        measured = measurements(Path(folder))
        if unknown := set(options.only or ()) - set(measured):
            parser.error(f"no ratio {', '.join(sorted(unknown))}; there are {', '.join(measured)}")
        return gate("guard", {name: measured[name] for name in options.only or measured}, options)


if __name__ == "__main__":
    sys.exit(main())
