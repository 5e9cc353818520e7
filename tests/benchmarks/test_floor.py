"""The lean solver of the benchmarks, and the page that sets the library beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
import sim
from nls import Cholesky
from tests.benchmarks.conftest import run

pytestmark = pytest.mark.skipif(Cholesky.missing() is not None, reason="the lean solver needs CHOLMOD")

PLANE = "EDGE_SE2 7 9 1 0 {angle} {information} 9 0 9\nEDGE_SE2 {last} 12 1 0 0 9 0 0 9 0 9\n"


def solved(part: Callable[[str], Any], path: Path) -> Any:
    done = part("peers.lean").Run(part("peers").Files(path, path, False), "chordal")
    for stage in (done.load, done.start, done.optimize):
        stage()
    return done


@pytest.mark.parametrize("world", ["manhattan", "grid3d"])
def test_the_optimum_is_that_of_the_library(world: str, part: Callable[[str], Any], tmp_path: Path) -> None:
    """Poses far from the origin, rotations up to pi, correlated information."""
    rng = np.random.default_rng(3)
    made = getattr(sim, world)(rng, n_poses=60)
    nls.save(tmp_path / "drawn.g2o", made.graph, made.start)
    tag, d = ("EDGE_SE2", 3) if world == "manhattan" else ("EDGE_SE3:QUAT", 6)
    lines = (tmp_path / "drawn.g2o").read_text().splitlines()
    for k, line in enumerate(lines):
        words = line.split()
        if words[0] == tag:
            L = 4 * np.eye(d) + rng.normal(size=(d, d))
            numbers = (L @ L.T)[np.triu_indices(d)]
            lines[k] = " ".join([*words[: -len(numbers)], *(f"{number:.12g}" for number in numbers)])
    path = tmp_path / "correlated.g2o"
    path.write_text("\n".join(lines) + "\n")
    lean = solved(part, path)
    graph, values, _ = nls.load(path)
    result = graph.optimize(nls.initialize(graph, values)[0], nls.GaussNewton(nls.Stop(update_tol=1e-10)))
    assert lean.cost() == pytest.approx(result.chi2_final, rel=1e-7)
    ids, X = lean.poses()
    stack = result.values.stack("x")
    np.testing.assert_array_equal(ids, stack.numbers)
    found = result.values.replaced({"x": X})
    assert graph.chi2(found) == pytest.approx(lean.cost(), rel=1e-12)  # its cost is that of its poses
    np.testing.assert_allclose(X[:, : d // 3 + 1], stack.X[:, : d // 3 + 1], atol=1e-3)


@pytest.mark.filterwarnings("ignore:string or file could not be read:DeprecationWarning")
@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"angle": "nan"}, "finite"),
        ({"angle": "east"}, "finite|unmatched"),
        ({"information": "9 10 0"}, "positive definite"),
        ({"last": "12"}, "itself"),
        ({"last": "11"}, "connected"),
    ],
    ids=lambda given: str(given),
)
def test_wrong_files_are_refused(wrong: dict[str, str], why: str, part: Callable[[str], Any], tmp_path: Path) -> None:
    path = tmp_path / "wrong.g2o"
    path.write_text(PLANE.format_map({"angle": "0", "information": "9 0 0", "last": "9"} | wrong))
    with pytest.raises(ValueError, match=why):
        solved(part, path)


def test_the_page(tmp_path: Path) -> None:
    words = ("--sets", "ring", "--rounds", 1, "--out", tmp_path)
    done = run("floor.py", *words)
    assert done.returncode == 0, done.stderr
    (row,) = [line for line in (tmp_path / "floor.md").read_text().splitlines() if line.startswith("| ring")]
    cells = [cell.strip(" *") for cell in row.split("|")]
    cold, floor = (float(cell.split(" (")[0]) for cell in cells[3:5])
    assert float(cells[5]) == pytest.approx(cold / floor, rel=0.05)
    assert int(cells[9].replace(",", "")) > int(cells[10].replace(",", "")) > 500
    refused = run("floor.py", *words, "--most", 0.01)
    assert refused.returncode == 1
    assert "more than 0.01 times the floor: ring" in refused.stderr
