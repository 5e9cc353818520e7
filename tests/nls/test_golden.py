"""Public pose graphs: the known optimum from the default start, and four conventions of one file from its own start."""

from __future__ import annotations

from pathlib import Path

import pytest

import nls

OPTIMUM = {  # chi2 in the convention g2o
    "pose-graphs-2d/manhattan.g2o": 3549.04,
    "pose-graphs-2d/intel.g2o": 45.0047,
    "pose-graphs-2d/CSAIL.g2o": 40.5551,
    "pose-graphs-2d/kitti_00.g2o": 98.322,
    "pose-graphs-2d/city10000.g2o.gz": 511.985,
    "pose-graphs-3d/smallGrid3D.g2o": 458.154,
    "pose-graphs-3d/parking-garage.g2o.gz": 1.23869,
    "pose-graphs-3d/sphere2500.g2o.gz": 727.150,
    "pose-graphs-3d/torus3D.g2o.gz": 14574.75,
}

INTEL, GARAGE = "pose-graphs-2d/input_INTEL.g2o", "pose-graphs-3d/parking-garage.g2o.gz"
CONVENTIONS = {  # start and optimum, from the estimate of the file
    (INTEL, "g2o"): (5149721.0448, 215.830235),
    (INTEL, "graphslam"): (7191686.3825, 215.840489),
    (INTEL, "gtsam"): (6700336.8217, 215.838121),
    (GARAGE, "g2o"): (16720.0182, 1.238691),
    (GARAGE, "graphslam"): (16720.0182, 1.238691),
    (GARAGE, "gtsam"): (16727.2039, 1.268385),
}


@pytest.mark.parametrize("name", OPTIMUM)
def test_the_default_reaches_the_known_optimum(name: str, data: Path) -> None:
    graph, values, _ = nls.load(data / name)
    start, _, _ = nls.initialize(graph, values)
    result = graph.optimize(start)
    assert result.converged
    assert result.iterations <= 10
    assert result.chi2_final == pytest.approx(OPTIMUM[name], rel=1e-5)


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
