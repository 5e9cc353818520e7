"""Options of ``nls solve`` that change the problem: kernels, methods, what is held, how lines read, covariances."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Huber
from factors.bundle import CAMERA, LENS
from nls.cli import main
from nls.optimizers import OPTIMIZERS
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, write

Captured = pytest.CaptureFixture[str]
OUTLIER = PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n"


def report_of(arguments: list[str], capsys: Captured, status: int = 0) -> dict[str, object]:
    assert main([*arguments, "--json", "-"]) == status
    return dict(json.loads(capsys.readouterr().out))


def bundle(folder: Path) -> Path:
    """Three cameras see five points, with a pixel of error."""
    from factors import BundleProjection, Isotropic
    from models import R

    rng = np.random.default_rng(4)
    camera = np.column_stack([0.1 * rng.normal(size=(3, 3)), [[0, 0, -10], [1, 0, -10], [0, 1, -11]]])
    lens, point = np.tile([500.0, 0.0, 0.0], (3, 1)), 2 * rng.normal(size=(5, 3))
    c, k, l = nls.kinds("c", "k", "l")
    values = nls.Values({c: (CAMERA, camera), k: (LENS, lens), l: (R(3), point)})
    i, j = np.repeat(np.arange(3), 5), np.tile(np.arange(5), 3)
    blank = BundleProjection(c[i], k[i], l[j], np.zeros((15, 2)), Isotropic(1))
    model, X = values.gather(blank)
    z = blank.predict(model.manifolds, *X)[0] + rng.normal(size=(15, 2))
    start = values.replaced({"l": point + 0.1 * rng.normal(size=(5, 3))})
    path = folder / "bundle.txt"
    nls.save(path, nls.FactorGraph([BundleProjection(c[i], k[i], l[j], z, Isotropic(1))]), start, dialect="bal")
    return path


def test_a_robust_kernel_on_every_factor(tmp_path: Path, capsys: Captured) -> None:
    file, out = write(tmp_path, OUTLIER), tmp_path / "out.g2o"
    plain = report_of(["solve", str(file)], capsys)
    robust = report_of(["solve", str(file), "--robust", "huber:1.5", "-o", str(out)], capsys)
    assert (plain["robust"], robust["robust"]) == (None, "huber:1.5")
    graph, values, _ = nls.load(file)
    start, _, _ = nls.initialize(nls.FactorGraph([f.robust(Huber(1.5)) for f in graph.factors]), values)
    expected = nls.FactorGraph([f.robust(Huber(1.5)) for f in graph.factors]).optimize(start)
    assert robust["chi2_final"] == expected.chi2_final < plain["chi2_final"]  # type: ignore[operator]
    assert np.array_equal(nls.load(out)[1][nls.Kind("x")], expected.values[nls.Kind("x")])
    assert main(["solve", str(file), "--robust", "cauchy:2"]) == 0
    assert "convention g2o, robust kernel cauchy:2" in capsys.readouterr().out


@pytest.mark.parametrize("method", list(OPTIMIZERS))
def test_methods_by_name(method: str, tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE))
    report = report_of(["solve", file, "--method", method, "--init", "file"], capsys)
    assert report["method"] == method
    assert report["chi2_final"] == pytest.approx(report_of(["solve", file], capsys)["chi2_final"], rel=1e-5)


def test_auto_damps_where_a_factor_asks_for_it(tmp_path: Path, capsys: Captured) -> None:
    assert report_of(["solve", str(write(tmp_path, PLANE))], capsys)["method"] == "gauss-newton"
    file = str(bundle(tmp_path))
    assert report_of(["solve", file, "--hold", "k"], capsys)["method"] == "levenberg-marquardt"


def test_a_kind_is_held(tmp_path: Path, capsys: Captured) -> None:
    file, out = bundle(tmp_path), tmp_path / "out.txt"
    report = report_of(["solve", str(file), "--hold", "k", "--hold", "c", "-o", str(out), "--to", "bal"], capsys)
    assert (report["held"], report["gauge"]) == (["k", "c"], "fixed by the graph itself")
    assert report["starts"].keys() == {"file"}  # type: ignore[attr-defined]
    assert report["dof"] == 30 - 15
    before, after = nls.load(file)[1], nls.load(out)[1]
    assert np.array_equal(after[nls.Kind("c")], before[nls.Kind("c")])
    assert np.array_equal(after[nls.Kind("k")], before[nls.Kind("k")])
    assert not np.array_equal(after[nls.Kind("l")], before[nls.Kind("l")])
    assert main(["solve", str(file), "--hold", "k"]) == 0
    assert "held        all k" in capsys.readouterr().out


def test_what_is_held_is_not_written_as_fixed(tmp_path: Path) -> None:
    file, out = write(tmp_path, PLANE + "FIX 2\n"), tmp_path / "out.g2o"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main(["solve", str(file), "--hold", "x", "-o", str(out), "--quiet"])
    if out.exists():
        assert [repr(keys) for keys in nls.load(out)[0].fixed] == ["x2"]


def test_directions_left_free_are_said(tmp_path: Path, capsys: Captured) -> None:
    """Cameras and points of a bundle keep their scale free, which a damped method does not notice by itself."""
    file = str(bundle(tmp_path))
    report = report_of(["solve", file, "--hold", "k"], capsys)
    assert report["converged"]
    assert report["underconstrained"]
    assert report_of(["solve", file, "--hold", "k", "--hold", "c"], capsys)["underconstrained"] == []


def test_covariances_are_written_at_an_optimum_only(tmp_path: Path, capsys: Captured) -> None:
    file, out = write(tmp_path, PLANE), tmp_path / "out.csv"
    report = report_of(["solve", str(file), "--covariance", str(out)], capsys)
    assert report["written"] == [str(out)]
    rows = [line.split(",") for line in out.read_text().splitlines()]
    assert rows[0][:4] == ["kind", "number", "status", "world_x_x"]
    assert [row[:3] for row in rows[1:3]] == [["x", "0", "gauge"], ["x", "1", "estimated"]]
    graph, values, _ = nls.load(file)
    result = graph.optimize(nls.initialize(graph, values)[0])
    Sigma = nls.Marginals(graph, result.values).covariance(nls.Kind("x")[1], frame="world")
    assert float(rows[2][3]) == pytest.approx(Sigma[0, 0], rel=1e-12)
    out.unlink()
    limit = ["solve", str(file), "--covariance", str(out), "--init", "file", "--max-iterations", "1"]
    report = report_of(limit, capsys, status=1)
    assert report["notes"] == [f"no covariances were written to {out}: this is no optimum"]
    assert report["written"] == []
    assert not out.exists()


@pytest.mark.parametrize("command", ["solve", "info"])
def test_how_lines_read_is_named(command: str, tmp_path: Path, capsys: Captured) -> None:
    lines = [f"EDGE2 {k} {k + 1} 1 0 0.1 100 0 50 200 0 0" for k in range(3)]
    file = str(write(tmp_path, "\n".join([*lines, "EDGE2 0 3 3 0.6 0.2 100 0 50 200 0 0"]), "a.txt"))
    assert main([command, file]) == 2
    assert "name the dialect" in capsys.readouterr().err
    report = report_of([command, file, "--dialect", "toro"], capsys)
    assert report["format"] == "toro"


@pytest.mark.parametrize("command", ["solve", "info"])
def test_negative_information_is_repaired_on_request_only(command: str, tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE + "EDGE_SE2 1 3 0 2 3 500 0 0 400 0 -3\n"))
    assert main([command, file]) == 2
    err = capsys.readouterr().err
    assert "negative eigenvalue" in err
    assert " [EDGE_SE2 1 3" in err
    assert err.endswith("\n  -> take the nearest matrix: --repair-information\n")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main([command, file, "--repair-information"]) == 0
    err = capsys.readouterr().err
    assert err.startswith("nls: warning: ")
    assert err.count("\n") == 1


def test_the_cure_is_named_as_it_is_typed(tmp_path: Path, capsys: Captured) -> None:
    assert main(["solve", str(write(tmp_path, PLANE)), "--gauge", "none"]) == 1
    err = capsys.readouterr().err
    assert "hold one pose of every part: --gauge first" in err
    assert "gauge='first'" not in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robust", "dcs"], "robust: 'dcs' is not possible; expected one of huber:NUMBER"),
        (["--robust", "huber:-1"], "Huber(c): -1.0 is not possible"),
        (["--robust", "magic:1"], "robust: 'magic:1' is not possible"),
        (["--robust", "huber:1", "--robust", "cauchy:1"], "--robust is given twice; expected one"),
        (["--report", "page.pdf"], "--report: 'page.pdf' is not possible; expected a file name ending in .html, .htm"),
        (["--hold", "q"], "--hold: 'q' is not possible; expected one of the kinds x"),
        (["--method", "magic"], "invalid choice: 'magic'"),
        (["--dialect", "latin"], "invalid choice: 'latin'"),
        (["--covariance", "nowhere/out.csv"], "nowhere/out.csv"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], message: str, tmp_path: Path, capsys: Captured) -> None:
    assert main(["solve", str(write(tmp_path, PLANE)), *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert message in err
    assert "internal error" not in err


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        (["slove", "FILE"], "solve"),
        (["solve", "FILE", "--gauge", "frist"], "first"),
        (["solve", "FILE", "--method", "gauss"], "gauss-newton"),
        (["solve", "FILE", "--robust", "hubre:1"], "huber"),
        (["solve", "FILE", "--robust", "Betwen=huber"], "Between"),
        (["solve", "FILE", "--robust", "gnc-tsl"], "gnc-tls"),
        (["explain", "FILE", "--certfy"], ""),
        (["solve", "FILE", "--certfy"], "--certify"),
        (["solve", "FILE", "--linear-solver", "zzz"], ""),
    ],
)
def test_a_misspelled_name_has_its_neighbor(arguments: list[str], near: str, tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE))
    assert main([file if word == "FILE" else word for word in arguments]) == 2
    err = capsys.readouterr().err
    assert (f"; did you mean '{near}'?" in err) if near else ("did you mean" not in err)


def test_a_kernel_without_its_number_gets_the_efficient_one(tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE))
    assert main(["solve", file, "--robust", "huber"]) == 0
    short = capsys.readouterr().out
    assert "note        --robust huber: taken as huber:1.345, 95 % efficient without outliers" in short
    assert main(["solve", file, "--robust", "huber:1.345"]) == 0
    long = capsys.readouterr().out
    assert [line for line in long.splitlines() if line.startswith("result")] == [
        line for line in short.splitlines() if line.startswith("result")
    ]
    for kernel in ("dcs", "huber:", "geman-mcclure"):
        assert main(["solve", file, "--robust", kernel]) == 2


def test_a_folder_with_a_graph_and_a_table_alone_are_told_apart(tmp_path: Path, capsys: Captured) -> None:
    write(tmp_path, PLANE)
    assert main(["solve", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith(f"\n  -> read the file in it: {tmp_path / 'graph.g2o'}\n")
    assert main(["solve", str(write(tmp_path, "a,b\n1,2\n", "log.csv"))]) == 2
    assert "\n  -> give the folder, if the table belongs to a mission" in capsys.readouterr().err
