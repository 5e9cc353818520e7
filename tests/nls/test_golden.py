"""Public pose graphs from their own start: the four conventions, a rise on the way, every sparse solver.

The optima from the default start are in `test_golden_data`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import nls

INTEL, GARAGE = "pose-graphs-2d/input_INTEL.g2o", "pose-graphs-3d/parking-garage.g2o.gz"
CONVENTIONS = {  # start and optimum, from the estimate of the file
    (INTEL, "g2o"): (5149721.0448, 215.830235),
    (INTEL, "graphslam"): (7191686.3825, 215.840489),
    (INTEL, "gtsam"): (6700336.8217, 215.838121),
    (GARAGE, "g2o"): (16720.0182, 1.238691),
    (GARAGE, "graphslam"): (16720.0182, 1.238691),
    (GARAGE, "gtsam"): (16727.2039, 1.268385),
}


@pytest.mark.parametrize(("name", "convention"), CONVENTIONS)
def test_conventions(name: str, convention: str, data: Path) -> None:
    graph, values, _ = nls.load(data / name, convention=convention)
    start, optimum = CONVENTIONS[name, convention]
    assert graph.chi2(values) == pytest.approx(start, rel=1e-6)
    result = graph.optimize(values)
    assert result.converged
    assert result.chi2_initial == pytest.approx(start, rel=1e-6)
    assert result.chi2_final == pytest.approx(optimum, rel=1e-5)


def test_intel_passes_through_a_rise(data: Path) -> None:
    """Undamped Gauss-Newton rises to 3.2e8 there; python-graphslam prints the same first and last numbers."""
    graph, values, _ = nls.load(data / INTEL, convention="graphslam")
    result = graph.optimize(values)
    assert result.history[1].chi2 > 10 * result.chi2_initial
    assert result.status is nls.Status.CONVERGED
    assert result.chi2_final == pytest.approx(215.8405, rel=1e-5)


@pytest.mark.parametrize("solver", ["cholesky", "qr", "lu"])
def test_every_sparse_solver_reaches_it(solver: str, data: Path) -> None:
    from nls.linear import SOLVERS

    linear_solver = SOLVERS[solver]()
    if (why := linear_solver.missing()) is not None:
        pytest.skip(f"{solver}: {why}")
    graph, values, _ = nls.load(data / "pose-graphs-2d/CSAIL.g2o")
    result = graph.optimize(values, linear_solver=linear_solver)
    assert result.chi2_final == pytest.approx(40.5551, rel=1e-5)
