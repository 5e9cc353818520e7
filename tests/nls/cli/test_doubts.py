"""What ``nls solve`` says of a result that is none, and where it names ``nls explain``; each once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import nls
from factors import Cauchy
from nls.analysis.chi_squared import chi2_interval
from nls.cli import main
from nls.cli.hint import asking, doubts
from nls.cli.parser import parser
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, write
from tests.nls.io.mission.mission_files import TINY, folder

Captured = pytest.CaptureFixture[str]
WRONG = PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n"


def report_of(arguments: list[str], capsys: Captured) -> dict[str, Any]:
    assert main([*arguments, "--json", "-"]) == 0
    return dict(json.loads(capsys.readouterr().out))


def labelled(out: str, label: str) -> list[str]:
    return [row.removeprefix(label).strip() for row in out.splitlines() if row.startswith(f"{label} ")]


def test_a_chi2_no_noise_explains_is_said_with_its_causes(tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, WRONG))
    assert main(["solve", file]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    graph, values, _ = nls.load(file)
    result = graph.optimize(nls.initialize(graph, values)[0])
    ratio = result.chi2_final / result.dof
    (note,) = labelled(out, "note")
    assert note.startswith(f"chi2 is {ratio:.3g} times its expectation: wrong sigmas, outliers, or ")
    assert "--robust cauchy:1" in note
    assert "--init" in note
    assert note.endswith(f"; see: nls explain {file}")
    assert "graph.robust" not in out
    assert f"degrees of freedom (ratio {ratio:.3g}, 1 expected)" in out
    assert report_of(["solve", file], capsys)["notes"] == [note]
    assert labelled(out, "result")[0].startswith("converged")
    main(["solve", file, "--verbose"])
    assert capsys.readouterr().out.count("times its expectation") == 1


@pytest.mark.parametrize("dof", [1, 3, 12, 300, 40_000])
def test_the_bound_is_that_of_explain(dof: int) -> None:
    """Below it nothing is said, above it one line; with a robust kernel chi2 has no expectation."""
    options = parser().parse_args(["solve", "a.g2o"])
    _, bound = chi2_interval(dof)

    def said(chi2: float, robust: bool = False) -> list[str]:
        result = nls.Result(nls.Values({}), nls.Status.CONVERGED, "", [], chi2, chi2, dof, "", "", {}, robust=robust)
        return doubts(result, options)

    assert said(0.9999 * bound) == said(0.5 * dof) == said(1.03 * bound, robust=True) == []
    assert said(1.0001 * bound) == ["chi2 is more than noise explains; see: nls explain a.g2o"]


def test_what_is_found_below_the_doubt_is_named(tmp_path: Path, capsys: Captured) -> None:
    """Four times what noise explains, where ``result.doubt`` says nothing yet."""
    file = str(write(tmp_path, PLANE + f"EDGE_SE2 1 3 0.5 2 3 {INFORMATION_2}\n", "a b.g2o"))
    graph, values, _ = nls.load(file)
    result = graph.optimize(nls.initialize(graph, values)[0])
    assert not result.doubt
    assert 2 < result.chi2_final / result.dof < 100
    assert report_of(["solve", file], capsys)["notes"] == [
        f"chi2 is more than noise explains; see: nls explain '{file}'"
    ]
    assert main(["explain", file]) == 0
    assert "chi2 is as expected" not in capsys.readouterr().out


def test_the_command_reads_the_same_graph(capsys: Captured) -> None:
    how = ["--dialect", "toro", "--convention", "log", "--robust", "huber:2", "--repair-information", "--hold", "k"]
    how += ["--init", "file"]
    words = asking(parser().parse_args(["solve", "a.txt", *how, "--quiet"])).split()
    assert words[:3] == ["nls", "explain", "a.txt"]
    asked, given = (vars(parser().parse_args(each)) for each in (words[1:], ["solve", "a.txt", *how]))
    for name in ("file", "dialect", "convention", "robust", "repair_information", "hold", "elevation", "init"):
        assert asked[name] == given[name]
    wrong = ["solve", "a.g2o", "--robust", "gnc-tls"]
    assert asking(parser().parse_args(wrong)) == "nls explain a.g2o"
    options = parser().parse_args([*wrong, "-o", "out.g2o", "--dialect", "toro"])
    assert asking(options, ["out.g2o"]) == "nls explain out.g2o"  # which is no toro file
    assert asking(options) == "nls explain a.g2o --dialect toro"  # nothing was written
    assert asking(parser().parse_args(["solve", "--", "-a  b.g2o"])) == "nls explain './-a  b.g2o'"


def test_no_optimum_names_explain(tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE))
    assert main(["solve", file, "--init", "file", "--max-iterations", "1", "--quiet"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "--max-iterations" in err
    assert err.endswith(f"; see: nls explain {file} --init file\n")
    arguments = ["solve", file, "--init", "file", "--max-iterations", "1", "--allow-unconverged"]
    assert main(arguments) == 0
    assert "--allow-unconverged" not in capsys.readouterr().err
    assert main([*arguments, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_what_is_free_is_said_of_a_graph_with_wrong_closures_too(tmp_path: Path, capsys: Captured) -> None:
    free = "VERTEX_XY 9 1 1\nEDGE_BEARING_SE2_XY 1 9 0.3 100\n"
    file, where = str(write(tmp_path, PLANE + free)), tmp_path / "r.json"
    assert main(["solve", file, "--robust", "gnc-tls", "--json", str(where)]) == 1
    assert capsys.readouterr().err.endswith(f"\n  -> see: nls explain {file}\n  -> written: {where}\n")
    assert json.loads(where.read_text())["underconstrained"]


@pytest.mark.parametrize("option", ["--json", "--covariance"])
def test_what_is_read_is_replaced_by_the_graph_alone(option: str, tmp_path: Path, capsys: Captured) -> None:
    path = write(tmp_path, PLANE)
    for command in ["solve", "explain"] if option == "--json" else ["solve"]:
        assert main([command, str(path), option, str(path)]) == 2
        assert "another name: this is the input" in capsys.readouterr().err
        assert path.read_text() == PLANE
    assert main(["solve", str(path), "-o", str(path), "--quiet"]) == 0
    assert path.read_text() != PLANE


def test_a_failed_solve_says_why_and_what_it_wrote(tmp_path: Path, capsys: Captured) -> None:
    file, page, where = str(write(tmp_path, PLANE)), tmp_path / "p.html", tmp_path / "r.json"
    for quiet in ([], ["--quiet"]):
        arguments = ["solve", file, "--gauge", "none", "--report", str(page), "--json", str(where), *quiet]
        assert main(arguments) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 6
        assert err.endswith(f"\n  -> see: nls explain {file}\n  -> written: {page}, {where}\n")
        report = json.loads(where.read_text())
        assert (report["converged"], report["status"]) == (False, "UNDERCONSTRAINED")
        assert report["underconstrained"]
        assert report["written"] == [str(page), str(where)]
        assert "hold one pose of every part: --gauge first" in report["advice"]
        assert "Not solved" in page.read_text()
        where.unlink()
        page.unlink()


def test_nothing_of_the_kind_of_a_good_result(tmp_path: Path, capsys: Captured) -> None:
    for options in ([], ["--robust", "cauchy:1"]):
        main(["solve", str(write(tmp_path, PLANE)), *options])
        out = capsys.readouterr().out
        assert labelled(out, "note") == []
        assert ("1 expected)" in out) == (not options)


def test_a_kernel_on_one_type_of_factor(tmp_path: Path, capsys: Captured) -> None:
    here = str(folder(tmp_path / "m", contacts=TINY["contacts"].replace("2,12,4.2289", "2,12,4.4289")))
    report = report_of(["solve", here, "--robust", "RangeAzimuth=cauchy:1", "--init", "odometry"], capsys)
    assert report["robust"] == "RangeAzimuth=cauchy:1"
    graph, values, _ = nls.load(here)
    graph.factors = [f.robust(Cauchy(1.0)) if f.name == "RangeAzimuth" else f for f in graph.factors]
    expected = graph.optimize(nls.initialize(graph, values, "odometry")[0])
    assert report["chi2_final"] == expected.chi2_final
    every = report_of(["solve", here, "--robust", "cauchy:1", "--init", "odometry"], capsys)
    assert every["chi2_final"] != report["chi2_final"]
    assert main(["solve", here, "--robust", "Between=cauchy:1"]) == 2
    assert main(["solve", here, "--robust", "=cauchy:1"]) == 2
    assert "expected no type, or one of those in the graph: XYH, ZPR, Pos" in capsys.readouterr().err
    assert main(["solve", here, "--robust", "XYH=dcs"]) == 2
    assert "robust: 'dcs' is not possible" in capsys.readouterr().err


@pytest.mark.parametrize("n", [8, 20])
def test_landmarks_seen_once_are_free_one_by_one(n: int, tmp_path: Path, capsys: Captured) -> None:
    once = "".join(f"1,{k},4.0,{0.01 * (k - 30)!r},0.01,0.004\n" for k in range(20, 20 + n))
    here = str(folder(tmp_path / "m", contacts=TINY["contacts"] + once))
    assert main(["solve", here, "--json", str(tmp_path / "r.json")]) == 0
    out = capsys.readouterr().out
    rows = labelled(out, "free")
    assert [row.split(":")[0] for row in rows[:12]] == [f"l{k}" for k in range(20, 20 + min(n, 12))]
    assert rows[12:] == (["and 8 more directions"] if n == 20 else [])
    assert not any(";" in row for row in rows)
    assert len(json.loads((tmp_path / "r.json").read_text())["underconstrained"]) == n
    assert "underconstrained" not in out
    assert f"free: {n} directions" in labelled(out, "result")[0]


@pytest.mark.filterwarnings("always")
def test_a_warning_is_said_once(tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE + "UNKNOWN 1 2\n"))
    for command in ("solve", "info"):
        assert main([command, file]) == 0
        out, err = capsys.readouterr()
        assert err.count("UNKNOWN") == 1
        assert "UNKNOWN" not in "".join(row for row in out.splitlines() if not row.startswith("  UNKNOWN"))
    assert main(["solve", file, "--json", "-"]) == 0
    assert any("UNKNOWN" in note for note in json.loads(capsys.readouterr().out)["notes"])


def test_what_a_file_holds_fixed_is_held_by_both_commands(tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, PLANE + "FIX 2\n"))
    for command in ("solve", "explain"):
        assert main([command, file]) == 0
        assert "gauge: fixed by the graph itself" in capsys.readouterr().out


def test_parts_that_nothing_joins_are_a_note_of_solve(tmp_path: Path, capsys: Captured) -> None:
    part = "VERTEX_SE2 10 5 5 0\nVERTEX_SE2 11 6 5 0\nEDGE_SE2 10 11 1 0 0 500 0 0 400 0 300\n"
    assert main(["solve", str(write(tmp_path, PLANE + part))]) == 0
    notes = labelled(capsys.readouterr().out, "note")
    assert (
        sum(
            note.startswith("the graph has 2 parts that no measurement joins (4 with x0, 2 with x10)") for note in notes
        )
        == 1
    )
    assert main(["solve", str(write(tmp_path, PLANE))]) == 0
    assert "no measurement joins" not in capsys.readouterr().out
    held = PLANE + part + "FIX 0\nFIX 10\n"
    assert main(["solve", str(write(tmp_path, held))]) == 0
    assert "no measurement joins" not in capsys.readouterr().out
