"""Values and covariances as tables."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Isotropic, Range
from models import SE2, SE3, R
from models.errors import GraphFileError, OptionError
from nls import GraphWarning, Marginals, Values
from nls.io.table import values_text, write_covariances
from tests.combinations import for_all
from tests.nls.graphs import l, mixed, pose_graph, x, y


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@for_all(frame=["world", "body"])
def test_every_number_reads_back(frame: str, tmp_path: Path) -> None:
    sample = mixed(5, held=True)
    marginals = Marginals(sample.graph, sample.values)
    path = tmp_path / "covariances.csv"
    write_covariances(path, marginals, frame=frame)
    rows = table(path)
    assert len(rows) == len(sample.values)
    assert [row["kind"] + row["number"] for row in rows] == [repr(key) for key in sample.values]
    for row in rows:
        kind = {"x": x, "l": l, "y": y}[row["kind"]]
        key = kind[int(row["number"])]
        manifold = sample.values.stack(row["kind"]).manifold
        said = frame if manifold is SE2 else "world"
        names = manifold.components
        Sigma = np.array(
            [[float(row[f"{said}_{'_'.join(sorted((a, b), key=names.index))}"]) for b in names] for a in names]
        )
        expected = marginals.covariance(key, frame)
        np.testing.assert_allclose(Sigma, expected, rtol=1e-11, atol=1e-300)
        filled = {name for name, cell in row.items() if cell} - {"kind", "number", "status"}
        assert len(filled) == manifold.dim * (manifold.dim + 1) // 2
        assert (row["status"] == "fixed") is (key in (x[7], x[1000], l[5])) is not Sigma.any()


def test_what_has_no_covariance_has_no_numbers_and_the_others_have(tmp_path: Path) -> None:
    """A pose that nothing measures, and a landmark with one range to it."""
    sample = pose_graph(SE2)
    sample.graph.add(Range(x[3], l[0], [5.0], Isotropic(0.1)))
    values = Values({x: (SE2, [[0, 0, 0], *sample.values[x]], [90, *range(8)]), l: (R(2), [[4.0, 3.0]])})
    with pytest.warns(GraphWarning):
        marginals = Marginals(sample.graph, values)
    write_covariances(tmp_path / "out.csv", marginals)
    lost, *poses, landmark = table(tmp_path / "out.csv")
    assert (lost["status"], {cell for name, cell in lost.items() if name.startswith("world")}) == ("unmeasured", {""})
    assert (landmark["kind"], landmark["status"], landmark["world_x_x"]) == ("l", "free", "")
    assert [row["status"] for row in poses] == ["estimated"] * 8
    assert [float(row["world_y_y"]) for row in poses] == marginals.covariance(x[0:8], "world")[:, 1, 1].tolist()


def test_refusals(tmp_path: Path) -> None:
    sample = pose_graph(SE2)
    marginals = Marginals(sample.graph, sample.values)
    with pytest.raises(OptionError, match="frame: 'map' is not possible"):
        write_covariances(tmp_path / "out.csv", marginals, frame="map")
    assert not list(tmp_path.iterdir())
    with pytest.raises(GraphFileError, match="cannot be written"):
        write_covariances(tmp_path / "no" / "out.csv", marginals)


def test_numbers_read_back_and_cells_stay_empty() -> None:
    X = SE3.exp(np.random.default_rng(0).normal(size=(3, 6)))
    values = Values({x: (SE3, X, [5, 6, 9]), l: (R(2), [[1 / 3, 2.0]])})
    report = nls.LoadReport("a", "g2o", "3-D", "log", vertex_times={"x": np.array([0.1, 0.2, 0.7])})
    rows = list(csv.DictReader(values_text("a.csv", "csv", nls.FactorGraph(), values, report)[0].decode().splitlines()))
    columns = ("x", "y", "z", "qx", "qy", "qz", "qw")
    assert list(rows[0]) == ["kind", "number", "time_s", *columns]
    assert [[float(row[c]) for c in columns] for row in rows[:3]] == X.tolist()
    assert [(row["kind"], row["number"], row["time_s"]) for row in rows[2:]] == [("x", "9", "0.7"), ("l", "0", "")]
    assert [rows[3][c] for c in columns] == [repr(1 / 3), "2.0", "", "", "", "", ""]
    assert values_text("a.csv", "csv", nls.FactorGraph(), Values(), None)[0] == b"kind,number\n"
