"""The same input gives the same bits (P8): run after run, whatever the hash seed and the threads of OpenMP and BLAS."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from factors import Between, Factor, Information, Isotropic, Prior
from models import SE2, SE3, LieGroup
from nls import FactorGraph, Marginals, Values
from nls.linear import SOLVERS
from tests.nls.graphs import between, distance, mixed, pose_graph, x

ROOT = Path(__file__).parents[2]

SCRIPT = """
import hashlib, sys
import numpy as np
import nls, sim
from models import SE2, SE3
from nls.linear import SOLVERS
from tests.nls.graphs import mixed, pose_graph, x
solver = SOLVERS[sys.argv[1]]
h = hashlib.sha256()
world = sim.grid3d(np.random.default_rng(1), n_poses=300)
problems = [(s.graph, s.values) for s in (pose_graph(SE2, n=40), pose_graph(SE3, n=40), mixed(0))]
problems += [(world.graph, world.start)]
for graph, values in problems:
    for optimizer in (nls.GaussNewton(), nls.LevenbergMarquardt()):
        result = graph.optimize(values, optimizer, solver())
        for stack in result.values.stacks.values():
            h.update(stack.X.tobytes("C"))
        h.update(repr([(it.chi2, it.update, it.gradient) for it in result.history]).encode())
    h.update(nls.initialize(graph, values)[0][x].tobytes() if len(values.stacks) == 1 else b"")
    h.update(nls.Marginals(graph, result.values).all(x, frame="body").tobytes())
print(h.hexdigest())
"""


def digest(solver: str, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, solver],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.parametrize("solver", ["cholesky", "cholesky-pcg", "qr", "lu", "schur", "pcg"])
def test_the_same_bits_in_every_process(solver: str) -> None:
    """Twice the same; another hash seed; one or two threads of OpenMP and of BLAS."""
    if (why := SOLVERS[solver].missing()) is not None:
        pytest.skip(why)
    first = digest(solver, PYTHONHASHSEED="0")
    assert len(first.strip()) == 64
    assert digest(solver, PYTHONHASHSEED="0") == first
    for environment in (
        {"PYTHONHASHSEED": "4711"},
        {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"},
    ):
        assert digest(solver, **environment) == first, environment


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_the_order_of_factors_changes_rounding_only(group: LieGroup) -> None:
    """chi2 and A'A are sums over factors: another order of the factors agrees to rounding, not to the bit."""
    sample = pose_graph(group, n=20, seed=3)
    first = sample.graph.optimize(sample.values)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(sample.graph.factors))
        again = FactorGraph([sample.graph.factors[k] for k in order]).optimize(sample.values)
        assert distance(group, first.values[x], again.values[x]) < 1e-9
        assert again.chi2_final == pytest.approx(first.chi2_final, rel=1e-11)
        assert (again.status, again.iterations) == (first.status, first.iterations)


def test_the_order_of_equal_measurements_in_a_batch_changes_nothing() -> None:
    """Equal lines of a file, swapped, are the same file."""
    sample = pose_graph(SE2, n=12)
    loop = between(sample)[1]
    assert isinstance(loop.noise, Information)
    z, I = np.tile(loop.z[:1], (4, 1)), np.tile(loop.noise.matrix[:1], (4, 1, 1))
    twins = [Between(x[np.zeros(4, int)], x[np.full(4, 11)], z[order], Information(I[order])) for order in TWO_ORDERS]
    found = [FactorGraph([*sample.graph.factors, twin]).optimize(sample.values).values[x].tobytes() for twin in twins]
    assert found[0] == found[1]


TWO_ORDERS = ([0, 1, 2, 3], [3, 1, 0, 2])


def test_the_order_in_which_values_are_written_down_does_not_matter() -> None:
    """A dictionary filled in another order is another order of columns: the same estimate to rounding."""
    sample = mixed(2)
    stacks = {name: (s.manifold, s.X, s.numbers) for name, s in sample.values.stacks.items()}
    other = Values(dict(reversed(stacks.items())))
    one, two = sample.graph.optimize(sample.values), sample.graph.optimize(other)
    assert two.chi2_final == pytest.approx(one.chi2_final, rel=1e-12)
    for name, stack in one.values.stacks.items():
        assert np.abs(stack.manifold.local(stack.X, two.values.stacks[name].X)).max() < 1e-9


def test_a_graph_that_was_solved_before_gives_the_same_bits() -> None:
    """Nothing an optimization leaves behind in a graph or its factors changes the next one."""
    sample, fresh = mixed(1), mixed(1)
    sample.graph.optimize(sample.values, linear_solver=SOLVERS["lu"]())
    Marginals(sample.graph, sample.truth)
    extra = Prior(x[40], SE2.identity()[0], Isotropic(0.1))
    sample.graph.add(extra)
    sample.graph.optimize(sample.values)
    sample.graph.remove(extra)
    one, two = (s.graph.optimize(s.values) for s in (sample, fresh))
    for name, stack in one.values.stacks.items():
        assert stack.X.tobytes("C") == two.values.stacks[name].X.tobytes("C")
    assert one.reason == two.reason


def test_a_random_state_of_the_caller_is_neither_used_nor_changed() -> None:
    sample = pose_graph(SE2, anchored=False)
    np.random.seed(3)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # type: ignore[index, union-attr]  # noqa: NPY002
    first = sample.graph.optimize(sample.values)
    factor: Factor = sample.graph.factors[0]
    assert np.array_equal(np.random.get_state()[1], state)  # type: ignore[arg-type]  # noqa: NPY002
    np.random.seed(4)  # noqa: NPY002
    assert sample.graph.optimize(sample.values).values[x].tobytes() == first.values[x].tobytes()
    assert factor is sample.graph.factors[0]
