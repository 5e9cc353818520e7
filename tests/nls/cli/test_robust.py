"""``nls solve --robust gnc-tls``: the wrong closures in the table, the report and the exit status."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from nls.cli import main
from tests.nls.robust.test_graduated import names, wrong_closures


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """A city with twenty wrong closures in two groups, and their names."""
    world = sim.manhattan(np.random.default_rng(3), n_poses=300)
    wrong = wrong_closures(world, 20, np.random.default_rng(4), 10)
    path = tmp_path_factory.mktemp("spoiled") / "city.g2o"
    nls.save(path, nls.FactorGraph([*world.graph.factors, wrong]), world.truth)
    return path, names(wrong)


@pytest.mark.parametrize("loss", ["tls", "gm:0.999"])
def test_what_was_rejected_is_said(
    spoiled: tuple[Path, set[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str], loss: str
) -> None:
    path, wrong = spoiled
    report = tmp_path / "r.json"
    assert main(["solve", str(path), "--robust", f"gnc-{loss}", "--json", str(report), "--certify"]) == 0
    said = capsys.readouterr()
    record = json.loads(report.read_text())
    rejected = {each["factor"] for each in record["rejected"]}
    assert wrong <= rejected
    assert len(rejected) <= len(wrong) + 0.05 * record["doubted"]
    assert record["init"] == f"gnc-{loss}"
    assert record["certificate"]["verdict"] == "certified"
    assert record["chi2_final"] < 2 * record["dof"]
    assert f"{len(rejected)} of {record['doubted']} doubted measurements rejected" in said.out
    assert record["rejected"][0]["factor"] in said.out
    assert not said.err


def test_plain_least_squares_is_bent_by_the_same(spoiled: tuple[Path, set[str]], tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    main(["solve", str(spoiled[0]), "--json", str(report), "--quiet"])
    record = json.loads(report.read_text())
    assert "rejected" not in record
    assert record["chi2_final"] > 10 * record["dof"]


def test_the_page_lists_them(spoiled: tuple[Path, set[str]], tmp_path: Path) -> None:
    path, wrong = spoiled
    page = tmp_path / "page.html"
    assert main(["solve", str(path), "--robust", "gnc-tls", "--report", str(page), "--quiet"]) == 0
    text = page.read_text()
    assert sum(name in text for name in wrong) >= 5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--robust", "gnc-tsl"], "gnc-tls[:PROBABILITY] or gnc-gm"),
        (["--robust", "gnc-tls:2"], "such as gnc-tls:0.99"),
        (["--robust", "gnc-tls:x"], "such as gnc-tls:0.99"),
        (["--robust", "gnc-tls:"], "such as gnc-tls:0.99"),
        (["--robust", "gnc"], "gnc-tls[:PROBABILITY] or gnc-gm"),
        (["--robust", "Between=gnc-tls"], "gnc-tls[:PROBABILITY] or gnc-gm"),
        (["--robust", "gnc-tls", "--init", "chordal"], "begins with odometry"),
    ],
)
def test_what_is_not_possible_is_one_line(
    spoiled: tuple[Path, set[str]], capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert main(["solve", str(spoiled[0]), *options]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


def test_a_graph_without_closures_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "chain.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n")
    assert main(["solve", str(path), "--robust", "gnc-tls"]) == 2
    err = capsys.readouterr().err
    assert "no loop closures, and sightings of landmarks and other measurements are not judged" in err
    assert err.endswith("\n  -> use a robust kernel: --robust cauchy:1\n")


def test_the_output_is_the_graph_without_them(
    spoiled: tuple[Path, set[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, wrong = spoiled
    out = tmp_path / "out.g2o"
    assert main(["solve", str(path), "--robust", "gnc-tls", "-o", str(out)]) == 0
    assert "without the" in capsys.readouterr().out
    before, (graph, values, _) = nls.load(path)[0], nls.load(out)
    written = {factor.describe(k) for factor in graph.factors for k in range(len(factor))}
    assert not written & wrong
    assert len(before) - len(graph) >= len(wrong)
    assert graph.chi2(values) < 2 * 3 * len(graph)
    assert main(["solve", str(out)]) == 0


def test_what_is_left_keeps_its_times(tmp_path: Path) -> None:
    lines = [f"VERTEX_SE2 {k}.5 A{k} {k} 0 0" for k in range(8)]
    pairs = [(i, i + step) for step in (1, 2) for i in range(8 - step)]
    good = [f"EDGE_SE2 {i}.{j} A{i} A{j} {j - i} 0 0 0.01 0 0 0.01 0 0.01" for i, j in pairs]
    wrong = "EDGE_SE2 9.25 A1 A6 9 9 0 0.01 0 0 0.01 0 0.01"
    (tmp_path / "a.pyfg").write_text("\n".join([*lines, *good[:9], wrong, *good[9:]]))
    command = ["solve", str(tmp_path / "a.pyfg"), "--robust", "gnc-tls", "-o", str(tmp_path / "b.pyfg"), "--quiet"]
    assert main([*command, "--allow-doubtful"]) == 0  # with sigmas larger than the map
    ((_, times),) = nls.load(tmp_path / "b.pyfg")[2].factor_times
    assert times.tolist() == [float(line.split()[1]) for line in good]
