"""What ``nls solve`` says of a result that converged and is none: where chi2 comes from, what is free; each once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
from factors import Between, Cauchy, Isotropic, Prior, SqrtInformation
from models import SE2
from nls.cli import main
from nls.cli.doubts import doubts
from tests.nls.g2o_files import INFORMATION_2, PLANE, write
from tests.nls.mission_files import TINY, folder

Captured = pytest.CaptureFixture[str]
WRONG = PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n"
x, l = nls.kinds("x", "l")


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
    notes = labelled(out, "note")
    assert len(notes) == 3
    assert notes[0].startswith(
        f"chi2 is {ratio:.3g} times its expectation: wrong sigmas, outliers (try --robust cauchy:1)"
    )
    assert "--init" in notes[0]
    assert "graph.robust" not in out
    (edges,) = graph.factors
    chi2 = edges.chi2(result.values)
    assert notes[1] == f"chi2 per measurement: Between {chi2.mean():.3g} (3 expected)"
    order = np.argsort(-chi2)[:3]
    named = [f"{edges.describe(int(k))} {np.sqrt(chi2[k]):.3g} sigmas" for k in order]
    assert notes[2] == f"farthest from what they should be: {', '.join(named)}"
    assert f"degrees of freedom (ratio {ratio:.3g}, 1 expected)" in out
    assert report_of(["solve", file], capsys)["notes"] == notes
    assert labelled(out, "result")[0].startswith("converged")
    main(["solve", file, "--verbose"])
    assert capsys.readouterr().out.count("times its expectation") == 1


def test_nothing_of_the_kind_of_a_good_result(tmp_path: Path, capsys: Captured) -> None:
    for options in ([], ["--robust", "cauchy:1"]):
        main(["solve", str(write(tmp_path, PLANE)), *options])
        out = capsys.readouterr().out
        assert labelled(out, "note") == []
        assert ("1 expected)" in out) == (not options)


def test_types_of_factors_apart(tmp_path: Path, capsys: Captured) -> None:
    """A range that is a meter off: the contacts are what is wrong, and that one is the worst."""
    here = str(folder(tmp_path / "m", contacts=TINY["contacts"].replace("2,12,4.2289", "2,12,5.2289")))
    notes = report_of(["solve", here], capsys)["notes"]
    by_type = next(note for note in notes if note.startswith("chi2 per measurement: "))
    said = {name: float(chi2) for name, chi2, *_ in (part.split() for part in by_type[22:].split(", "))}
    assert said.keys() == {"XYH", "ZPR", "Position", "Heading", "RangeAzimuth", "ElevationHinge"}
    assert "ElevationHinge" in by_type
    assert "RangeAzimuth" in by_type
    assert "(0 expected)" in by_type  # the hinge measures nothing
    graph, values, _ = nls.load(here)
    solved = graph.optimize(nls.initialize(graph, values)[0]).values
    for factor in graph.factors:
        assert said[factor.name] == pytest.approx(factor.chi2(solved).mean(), rel=5e-3, abs=1e-12)
    assert "farthest" in notes[-1]


def test_what_says_nothing_is_not_expected() -> None:
    """A step of a log knows x and y and not the yaw, one more knows all three: 7 numbers in 3 measurements."""
    steps = [[1.0, 0.0, 0.0], [9.0, 0.0, 0.0]]
    some = Between(x[[0, 1]], x[[1, 2]], steps, SqrtInformation(np.diag([100.0, 100.0, 0.0])))
    whole = Between(x[0], x[2], [2.0, 0.0, 0.0], Isotropic(0.01))
    graph = nls.FactorGraph([some, whole, Prior(x[0:3], np.zeros((3, 3)), Isotropic(1.0))])
    result = graph.optimize(nls.Values({x: (SE2, np.zeros((3, 3)))}))
    chi2 = (some.chi2(result.values).sum() + whole.chi2(result.values).sum()) / 3
    assert f"per measurement: Between {chi2:.3g} (2.33 expected), Prior" in doubts(graph, result)[1]


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
    assert main(["solve", here, "--robust", "XYH=cauchy"]) == 2
    assert "robust: 'cauchy' is not possible" in capsys.readouterr().err


@pytest.mark.parametrize("n", [8, 20])
def test_landmarks_seen_once_are_free_one_by_one(n: int, tmp_path: Path, capsys: Captured) -> None:
    once = "".join(f"1,{k},4.0,{0.01 * (k - 30)!r},0.01,0.004\n" for k in range(20, 20 + n))
    here = str(folder(tmp_path / "m", contacts=TINY["contacts"] + once))
    assert main(["solve", here, "--json", str(tmp_path / "r.json")]) == 0
    out = capsys.readouterr().out
    rows = labelled(out, "free")
    assert [row.split(":")[0] for row in rows[:12]] == [f"l{k}" for k in range(20, 20 + min(n, 12))]
    assert rows[12:] == (["and 8 more directions (--json has them)"] if n == 20 else [])
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
