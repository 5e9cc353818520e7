"""Options of ``nls solve`` that change the problem: kernels, methods, what is held, how lines read."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import BundleProjection, Cauchy, Huber, Isotropic
from factors.bundle import CAMERA, LENS
from models import R
from tests.nls.cli.shell import Shell, rows
from tests.nls.io.g2o_files import INFORMATION_2, PLANE
from tests.nls.missions.folder.mission_files import TINY, folder

OUTLIER = PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n"


def bundle(path: Path) -> str:
    """Three cameras see five points, with a pixel of error."""
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
    nls.save(path, nls.FactorGraph([BundleProjection(c[i], k[i], l[j], z, Isotropic(1))]), start, dialect="bal")
    return path.name


def test_a_robust_kernel_on_every_factor(shell: Shell) -> None:
    plain = shell.report(f"solve {shell.file(OUTLIER)}", 1)
    robust = shell.report("solve graph.g2o --robust huber:1.5 -o out.g2o --allow-doubtful")
    assert (plain["robust"], robust["robust"]) == (None, "huber:1.5")
    graph, values, _ = nls.load("graph.g2o")
    graph = nls.FactorGraph([f.robust(Huber(1.5)) for f in graph.factors])
    expected = graph.optimize(nls.initialize(graph, values)[0])
    assert robust["chi2_final"] == expected.chi2_final < plain["chi2_final"]
    assert np.array_equal(nls.load("out.g2o")[1][nls.Kind("x")], expected.values[nls.Kind("x")])
    assert "convention g2o, robust kernel cauchy:2" in shell("solve graph.g2o --robust cauchy:2 --allow-doubtful")
    short, long = (shell(f"solve graph.g2o --robust huber{c} --allow-doubtful") for c in ("", ":1.345"))
    assert "--robust huber: taken as huber:1.345, 95 % efficient without outliers" in rows(short, "note")
    assert rows(short, "result") == rows(long, "result")


def test_a_method_that_failed_is_in_the_report(shell: Shell) -> None:
    """Gauss-Newton cycles where one measurement contradicts all others; another method goes on."""
    report = shell.report(f"solve {shell.file(PLANE + f'EDGE_SE2 1 3 30 5 0.5 {INFORMATION_2}')} --init file", 1)
    (attempt,) = report["attempts"]
    assert (report["status"], attempt["method"], attempt["status"]) == ("CONVERGED", "gauss-newton", "CYCLING")
    assert set(attempt) == {"method", "status", "reason", "iterations"}


def test_a_kernel_on_one_type_of_factor(shell: Shell) -> None:
    folder(shell / "m", contacts=TINY["contacts"].replace("2,12,4.2289", "2,12,4.4289"))
    report = shell.report("solve m --robust RangeAzimuth=cauchy:1 --init odometry")
    assert report["robust"] == "RangeAzimuth=cauchy:1"
    graph, values, _ = nls.load("m")
    graph.factors = [f.robust(Cauchy(1.0)) if f.name == "RangeAzimuth" else f for f in graph.factors]
    expected = graph.optimize(nls.initialize(graph, values, "odometry")[0])
    assert report["chi2_final"] == expected.chi2_final
    every = shell.report("solve m --robust cauchy:1 --init odometry --allow-doubtful")
    assert every["chi2_final"] != report["chi2_final"]


def test_a_kind_is_held(shell: Shell) -> None:
    """Cameras and points keep their scale free, which a damped method does not notice by itself; held cameras not."""
    file = bundle(shell / "bundle.txt")
    free = shell.report(f"solve {file} --hold k")
    assert (free["method"], free["converged"]) == ("levenberg-marquardt", True)
    assert free["underconstrained"]
    report = shell.report(f"solve {file} --hold k --hold c -o out.txt --to bal")
    assert (report["held"], report["gauge"]) == (["k", "c"], "fixed by the graph itself")
    assert (list(report["starts"]), report["dof"], report["underconstrained"]) == (["file"], 30 - 15, [])
    before, after = nls.load(file)[1], nls.load("out.txt")[1]
    assert [np.array_equal(after[kind], before[kind]) for kind in nls.kinds("c", "k", "l")] == [True, True, False]
    assert rows(shell(f"solve {file} --hold k"), "held") == ["all k"]


def test_what_a_file_holds_fixed_is_held_and_the_rest_not_written_as_fixed(shell: Shell) -> None:
    shell.file(PLANE + "FIX 2\n")
    for command in ("solve", "explain"):
        assert "gauge: fixed by the graph itself" in shell(f"{command} graph.g2o")
    assert shell("solve graph.g2o --hold x -o out.g2o --quiet --allow-doubtful") == ""
    assert [repr(keys) for keys in nls.load("out.g2o")[0].fixed] == ["x2"]


def test_how_lines_read_is_named(shell: Shell) -> None:
    lines = [f"EDGE2 {k} {k + 1} 1 0 0.1 100 0 50 200 0 0" for k in range(3)]
    shell.file("\n".join([*lines, "EDGE2 0 3 3 0.6 0.2 100 0 50 200 0 0"]), "a.txt")
    for command in ("solve", "info"):
        assert shell.report(f"{command} a.txt --dialect toro")["format"] == "toro"


@pytest.mark.filterwarnings("always")
def test_negative_information_is_repaired_on_request(shell: Shell) -> None:
    shell.file(PLANE + "EDGE_SE2 1 3 0 2 3 500 0 0 400 0 -3\n")
    for command in ("solve", "info"):
        _, err = shell.both(f"{command} graph.g2o --repair-information")
        assert err.startswith("nls: warning: ")
        assert err.count("\n") == 1


@pytest.mark.filterwarnings("always")
def test_lines_are_left_out_as_the_refusals_advise(shell: Shell) -> None:
    """Followed to the letter, by every command that reads a graph."""
    shell.file(PLANE + "EDGE_A,B$x 1 2\n", "tags.g2o")
    shell.file(PLANE + "EDGE_SE2 3 77 1 0 0 1 0 0 1 0 1\n", "absent.g2o")
    for name in ("tags.g2o", "absent.g2o"):
        for command in ("solve {}", "explain {}", "info {}", "convert {} b.g2o", "plot {} b.png", "stream {}"):
            words = command.format(name)
            if words == "stream absent.g2o":  # which makes a variable where an edge names it
                continue
            cure = shell.refused(words).splitlines()[-1].split(" out: ")[1]
            _, err = shell.both(f"{words} {cure}")
            assert re.search(
                r"warning: .*(EDGE_A,B\$x \(1, first on line 9|1 edge to .* left out, first on line 9)", err
            )
