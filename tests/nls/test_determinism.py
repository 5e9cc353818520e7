"""Equal input gives equal bits (P8): run after run, whatever the hash seed and the threads of OpenMP and BLAS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from factors import Isotropic, Prior
from models import SE2
from nls import Marginals
from nls.linear import SOLVERS
from tests.nls.graphs import mixed, x

ROOT = Path(__file__).parents[2]

SCRIPT = """
import hashlib, json
import numpy as np
import nls, sim
from models import SE2, SE3
from nls.linear import SOLVERS
from tests.nls.graphs import mixed, pose_graph, x
world = sim.grid3d(np.random.default_rng(1), n_poses=60)
problems = [(s.graph, s.values) for s in (pose_graph(SE2, n=40), pose_graph(SE3, n=40), mixed(0))]
problems += [(world.graph, world.start)]

def digest(solver):
    h = hashlib.sha256()
    for graph, values in problems:
        for optimizer in (nls.GaussNewton(), nls.LevenbergMarquardt()):
            result = graph.optimize(values, optimizer, solver())
            for stack in result.values.stacks.values():
                h.update(stack.X.tobytes("C"))
            h.update(repr([(it.chi2, it.update, it.sigmas) for it in result.history]).encode())
        h.update(nls.Marginals(graph, result.values).all(x, frame="body").tobytes())
    return h.hexdigest()

solvers = ("cholesky", "qr", "lu", "schur", "pcg")
digests = {name: digest(SOLVERS[name]) for name in solvers if SOLVERS[name].missing() is None}
digests |= {str(k): nls.initialize(*problems[k])[0][x].tobytes().hex() for k in (0, 1, 3)}
print(json.dumps(digests))
"""


def digests(hash_seed: str, threads: str) -> dict[str, str]:
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=ROOT,
        env=os.environ
        | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": hash_seed}
        | {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return dict(json.loads(run.stdout))


def test_the_same_bits_in_every_process() -> None:
    """By every sparse solver, and from every start: another hash seed, one or two threads of OpenMP and of BLAS."""
    first = digests("0", "1")
    assert len(first) >= 3 + 4
    assert digests("4711", "2") == first


def test_a_graph_that_was_solved_before_gives_the_same_bits() -> None:
    """Nothing an optimization leaves behind changes the next one; a random state of the caller is no part of it."""
    sample, fresh = mixed(1), mixed(1)
    np.random.seed(3)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # type: ignore[index, union-attr]  # noqa: NPY002
    sample.graph.optimize(sample.values, linear_solver=SOLVERS["lu"]())
    Marginals(sample.graph, sample.truth)
    extra = Prior(x[40], SE2.identity()[0], Isotropic(0.1))
    sample.graph.add(extra)
    sample.graph.optimize(sample.values)
    sample.graph.remove(extra)
    one = sample.graph.optimize(sample.values)
    assert np.array_equal(np.random.get_state()[1], state)  # type: ignore[arg-type]  # noqa: NPY002
    np.random.seed(4)  # noqa: NPY002
    two = fresh.graph.optimize(fresh.values)
    for name, stack in one.values.stacks.items():
        assert stack.X.tobytes("C") == two.values.stacks[name].X.tobytes("C")
    assert (one.reason, [it.chi2 for it in one.history]) == (two.reason, [it.chi2 for it in two.history])
