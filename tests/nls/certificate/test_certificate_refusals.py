"""What cannot be certified is refused by name; ``nls solve --certify`` prints, reports and refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import BearingRange, Between, Diagonal, Huber, Information, Isotropic, Prior
from models import SE2, SE3, SO3, R
from nls import FactorGraph, Values
from nls.cli import main
from tests.nls.certificate.worlds import dominated
from tests.nls.graphs import l, pose_graph, x, y
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE, write

Captured = pytest.CaptureFixture[str]
CHAIN = Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.1], Isotropic(0.1))


def blind(*information: float) -> Between:
    return Between(x[0], x[2], [2, 0, 0], Information(np.diag(information).astype(float)))


VALUES = Values({x: (SE2, SE2.identity(3)), l: (R(2), np.zeros((2, 2))), y: (SE3, SE3.identity(2))})


REFUSED = [
    ([CHAIN, BearingRange(x[0], l[1], [0.1, 3.0], Isotropic(0.1))], r"BearingRange\(x0, l1\) is no measured"),
    ([CHAIN.robust(Huber(1.0))], r"Between\(.*\) has the robust kernel Huber\(1\)"),
    ([CHAIN, Prior(x[[0, 2]], [0, 0, 0], Isotropic(1))], "x0 and x2 are both held"),
    ([CHAIN, Prior(x[[0, 0, 2]], [0, 0, 0], Isotropic(1))], "x0 and x2 are both held"),
    ([CHAIN, *(Prior(x[k], [0, 0, 0], Isotropic(1)) for k in (1, 2))], "x1 and x2 are both held"),
    ([CHAIN, Prior(l[1], [0, 0], Isotropic(1))], r"Prior\(l1\) is on no pose"),
    ([CHAIN[[0]]], "x2 and x0 are not connected"),
    ([CHAIN, Between(y[0], y[1], SE3.identity(1), Isotropic(1))], "Between factors of SE2, SE3; expected"),
    ([], "Between factors of nothing; expected"),
    ([CHAIN, blind(1, 1, 0)], r"Between\(x0, x2\) has no info.*rot"),
    ([CHAIN, blind(1, 0, 1)], r"Between\(x0, x2\) has no info.*posi"),
]


def test_what_cannot_be_certified_is_named() -> None:
    for factors, message in REFUSED:
        with pytest.raises(nls.GraphError, match=f"certify: {message}"):
            nls.certify(FactorGraph(factors), VALUES)


def test_fixed_poses_and_other_spaces_are_refused() -> None:
    graph = FactorGraph([CHAIN, Prior(x[1], [0, 0, 0], Diagonal([1, 1, 1]))])
    values = graph.optimize(Values({x: (SE2, VALUES[x[:3]])})).values
    assert nls.certify(graph, values).verdict == "certified"
    assert nls.certify(graph, VALUES).verdict == "refuted"  # and no warning of values that nothing measures
    graph.fix(x[1])
    assert nls.certify(graph, values).verdict == "certified"  # the pose of the prior
    graph.fix(x[0])
    with pytest.raises(nls.GraphError, match="x0 and x1 are both held"):
        nls.certify(graph, VALUES)
    turns = FactorGraph([Between(x[0], x[1], SO3.identity(1), Isotropic(1))])
    with pytest.raises(nls.GraphError, match="Between factors of SO3; expected"):
        nls.certify(turns, Values({x: (SO3, SO3.identity(2))}))


def test_what_was_handed_in_stays_as_it_was() -> None:
    sample = pose_graph(SE3, anchored=False)
    before = sample.values.copy()
    certificate = nls.certify(sample.graph, sample.values)
    assert np.array_equal(before[x], sample.values[x])
    assert not np.allclose(certificate.values[x], before[x], atol=1e-4)


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
def test_the_command_line_says_it(tmp_path: Path, capsys: Captured, text: str) -> None:
    file, where = str(write(tmp_path, text)), tmp_path / "r.json"
    assert main(["solve", file, "--certify", "--verbose", "--json", str(where)]) == 0
    shown = capsys.readouterr().out
    assert re.search("(?m)^certificate certified.*This does not validate the measurements$", shown)
    assert "SE-Sync cost: " in shown
    assert "\ncertify  " in shown
    report = json.loads(where.read_text())
    found, seconds = report["certificate"], report["timings"]
    graph, values, _ = nls.load(file)
    start, *_ = nls.initialize(graph, values)
    expected = nls.certify(graph, graph.optimize(start).values)
    assert (found["verdict"], found["proved"], found["lower_chi2"], found["refuted"]) == ("certified", True, None, [])
    assert found["chi2_given"] == report["chi2_final"] == pytest.approx(found["chi2_reached"], rel=1e-5)
    assert found["cost"] == pytest.approx(expected.cost, rel=1e-12)
    assert found["cost_given"] == pytest.approx(expected.cost_given, rel=1e-12)
    assert [found["moved"]["distance"], found["moved"]["angle"]] == pytest.approx(expected.moved, rel=1e-6)
    assert len(found["eigenvalues"]) == (3 if text is PLANE else 4)
    assert seconds["total"] == pytest.approx(sum(seconds[k] for k in ("solved", "check", "certify", "write")))
    assert main(["solve", file, "--json", "-"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert "certificate" not in plain
    assert "certify" not in plain["timings"]


def square(tmp_path: Path) -> str:
    """A square whose corners start on one spot."""
    lines = [f"VERTEX_SE2 {k} 0 0 {0.001 * (k == 1)}" for k in range(4)]
    lines += [f"EDGE_SE2 {k} {(k + 1) % 4} 1 0 {np.pi / 2 + 0.05 * (k == 0)} {INFORMATION_2}" for k in range(4)]
    return str(write(tmp_path, "\n".join(lines) + "\n"))


def test_the_command_line_refutes_and_the_way_on_that_it_prints_is_certified(tmp_path: Path, capsys: Captured) -> None:
    out, where = str(tmp_path / "out.g2o"), tmp_path / "r.json"
    command = ["solve", square(tmp_path), "--init", "file", "-o", out, "--json", str(where)]
    assert main([*command, "--certify"]) == 1
    captured = capsys.readouterr()
    assert "\ncertificate refuted: " in captured.out
    first = json.loads(where.read_text())
    lower = first["certificate"]["lower_chi2"]
    assert lower < 1e-3 * first["chi2_final"]
    (way_on,) = re.findall("-> go on from there: (.*)", captured.out)
    assert re.search(rf"nls: refuted: .*; go on from there: {re.escape(way_on)}\n$", captured.err)
    assert main([*command, *way_on.split()]) == 0
    captured = capsys.readouterr()
    assert f"\nimproved    left at chi2 {first['chi2_final']:.9g}: went on from its better poses\n" in captured.out
    assert "\ncertificate certified: " in captured.out
    assert captured.err == ""
    report = json.loads(where.read_text())
    assert report["certificate"]["refuted"] == [first["chi2_final"]]
    assert report["chi2_final"] == pytest.approx(lower, rel=1e-5)
    assert report["init"] == "better poses"
    graph, values, _ = nls.load(out)  # what is written is the better one
    assert graph.chi2(values) == pytest.approx(report["chi2_final"], rel=1e-4)


def test_the_command_line_goes_on_from_a_solution_that_stopped_too_early(tmp_path: Path, capsys: Captured) -> None:
    graph, start = dominated(SE2, 1e4, 1)
    file = str(tmp_path / "far.npz")
    nls.save(file, graph, start)
    command = ["solve", file, "--init", "file", "--json", str(tmp_path / "r.json"), "--allow-doubtful"]
    assert main([*command, "--certify"]) == 0
    shown = capsys.readouterr().out
    assert "\ncertificate undecided: this solution stopped too early: " in shown
    (way_on,) = re.findall("-> go on from there: (.*)", shown)
    stopped = json.loads((tmp_path / "r.json").read_text())["chi2_final"]
    assert main([*command, *way_on.split()]) == 0
    shown = capsys.readouterr().out
    assert f"\nimproved    left at chi2 {stopped:.9g}: went on from its better poses\n" in shown
    assert "\ncertificate certified: " in shown
    assert json.loads((tmp_path / "r.json").read_text())["chi2_final"] == pytest.approx(9999**2 / 0.02, abs=0.1)


def test_a_certified_solution_is_not_improved(tmp_path: Path, capsys: Captured) -> None:
    assert main(["solve", square(tmp_path), "--improve", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["certificate"]["verdict"], report["certificate"]["refuted"]) == ("certified", [])
    assert "better poses" not in report["starts"]


@pytest.mark.filterwarnings("ignore::models.errors.GraphWarning")
def test_a_solution_is_written_before_its_certificate_fails(tmp_path: Path, capsys: Captured) -> None:
    weights = ["1e10", "1e10", "1e-10", "1e10", "1e10"]
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0.1 {w} 0 0 {w} 0 {w}" for k, w in enumerate(weights)]
    file, out = str(write(tmp_path, "\n".join(lines) + "\n")), tmp_path / "out.g2o"
    options = ["--certify", "--method", "levenberg-marquardt", "--json", "-", "-o", str(out)]
    assert main(["solve", file, *options]) == 2
    captured = capsys.readouterr()
    assert "nls: certify: the weights of positions differ by more than the digits" in captured.err
    assert "certificate" not in json.loads(captured.out)
    assert out.exists()
    out.unlink()
    assert main(["solve", file, "--improve", *options[1:]]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("nls: certify: the weights of positions differ by more than the digits") == 1
    assert out.exists()
