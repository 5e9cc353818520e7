"""What ``nls solve`` says of no result or a doubtful one, where that is marked; the report of ``nls explain``."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

import nls
from nls.cli import main
from nls.cli.graph_file import GraphFile
from nls.cli.parser import parser
from nls.cli.solve_report import doubtful
from nls.io import read_tum
from nls.missions.folder.table import csv_text
from nls.plot import picture
from tests.nls.cli.shell import PART, RAY, SPOILED, Shell, row, rows
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE
from tests.nls.missions.folder.mission_files import TINY, folder, raw
from tests.nls.plot.html_page import Page

undrawn, unwarned = pytest.mark.usefixtures("undrawn"), pytest.mark.filterwarnings("ignore::nls.GraphWarning")
KERNEL = "look at these rows, or solve with --robust Position=cauchy:1"

GNC = "; find wrong loop closures: nls solve --robust gnc-tls; try another initial guess: --init"


@pytest.mark.parametrize(
    ("closure", "way"), [("5 5 0", GNC), ("0.5 2 3", "")], ids=["above 100 times", "four times, where no kernel helps"]
)
def test_a_chi2_no_noise_explains_is_said_with_its_causes(closure: str, way: str, shell: Shell) -> None:
    file = shell.file(PLANE + f"EDGE_SE2 1 3 {closure} {INFORMATION_2}", "a b.g2o")
    out, report = shell(f"solve '{file}' --allow-doubtful"), shell.report(f"solve '{file}'", 1)
    graph, values, _ = nls.load(file)
    result = graph.optimize(nls.initialize(graph, values)[0])
    ratio = f"{result.chi2_final / result.dof:.3g}"
    notes = [f"implausible: {result.doubt}{way}; see: nls explain 'a b.g2o'"]
    assert rows(out, "note") == report["notes"] == notes
    assert f"chi2 is {ratio} times its expectation: " in notes[0]
    assert f"degrees of freedom (ratio {ratio}, 1 expected)" in out
    assert row(out, "result").endswith(f"; but {result.doubt}")
    assert (report["fit"], report["doubt"]) == ("IMPLAUSIBLE", result.doubt)


@pytest.mark.parametrize("options", ["", "--robust cauchy:1"])
def test_nothing_is_said_of_a_good_result(options: str, shell: Shell) -> None:
    out = shell(f"solve {shell.file()} {options}")
    assert rows(out, "note") == []
    assert "1 expected)" in out


def test_more_than_noise_explains_is_a_note_without_a_doubt() -> None:
    chi2, dof = 44_000.0, 40_000
    result = nls.Result(nls.Values({}), nls.Status.CONVERGED, "", [], chi2, chi2, dof, "", "", {})
    note = f"{result.misfit}; see: nls explain a.g2o"
    assert doubtful(GraphFile(parser().parse_args(["solve", "a.g2o"])), result) == [note]
    assert (note[:11], result.doubt) == ("chi2 is 1.1", "")


@undrawn
@unwarned
def test_fixes_that_jump_are_for_a_kernel_of_their_table(shell: Shell) -> None:
    """The note offers it, and under it the track is nearly that of good fixes."""
    t = np.arange(0.5, 20.0, 0.5)
    positions, tracks = np.outer(t, [np.cos(0.3), np.sin(0.3)]), []
    for jump in (0.0, 50.0):
        positions[[4, 17, 30], 0] += jump
        fixes = csv_text(["time_s", "x_m", "y_m", "sigma_x_m", "sigma_y_m"], t, positions, np.full((len(t), 2), 1.5))
        folder(shell / "m", raw() | {"fixes": fixes.decode()})
        for options in ("", " --robust Position=cauchy:1"):
            out, _ = shell.both(f"solve m{options} -o out", int(jump > 0 and not options))
            (note,) = [note for note in rows(out, "note") if note.startswith("implausible: ")] or [""]
            assert (note.endswith(f"{KERNEL}; see: nls explain m")) == (jump > 0 and not options)
            assert "try another initial guess" not in note
            tracks.append(read_tum(shell / "out" / "trajectory.tum")[1][:, :2])
    good, _, bent, robust = tracks
    away, near = (np.linalg.norm(track - good, axis=1).max() for track in (bent, robust))
    assert near < 0.5 < 2.0 < away


def test_the_command_reads_the_same_graph() -> None:
    how = "--dialect toro --convention log --robust huber:2 --repair-information --hold k --init file"
    how += " --drop-absent --ignore-tags EDGE_X,EDGE_Y"
    given = parser().parse_args(shlex.split(f"solve a.txt {how} --quiet"))
    words = shlex.split(GraphFile(given).asking())
    assert words[:3] == ["nls", "explain", "a.txt"]
    asked = parser().parse_args(words[1:])
    same = ("file", "dialect", "convention", "robust", "repair_information", "hold", "elevation", "init")
    for name in (*same, "drop_absent", "ignore_tags"):
        assert getattr(asked, name) == getattr(given, name)
    for words, written, expected in (
        ("solve a.g2o --robust gnc-tls -o o.g2o --dialect toro", ["o.g2o"], "o.g2o"),  # which is no toro file
        ("solve a.g2o --robust gnc-tls -o o.g2o --dialect toro", [], "a.g2o --dialect toro"),
        ("solve a.g2o --robust gnc-tls -o o.g2o --drop-absent", ["o.g2o"], "o.g2o --drop-absent"),
        ("solve a.g2o --robust gnc-tls -o o.npz --drop-absent", ["o.npz"], "o.npz"),  # has no lines
        ("solve -- '-a  b.g2o'", [], "'./-a  b.g2o'"),
    ):
        assert GraphFile(parser().parse_args(shlex.split(words))).asking(written) == f"nls explain {expected}"


@undrawn
def test_no_optimum_names_explain_and_the_best_so_far_is_written(shell: Shell) -> None:
    words = f"solve {shell.file()} --init file --max-iterations 1"
    out, err = shell.both(f"{words} -o out.g2o --report p.html", 1)
    assert "the iteration limit was reached" in out
    assert err.count("\n") == 1
    assert "--max-iterations, or take the estimate with --allow-unconverged" in err
    assert err.endswith("; see: nls explain graph.g2o --init file\n")
    assert "Not converged" in Page((shell / "p.html").read_text()).text
    (graph, start, _), (_, solution, _) = nls.load("graph.g2o"), nls.load("out.g2o")
    assert graph.chi2(solution) < graph.chi2(start)
    assert "--allow-unconverged" not in shell.both(f"{words} --allow-unconverged")[1]
    assert shell(f"{words} --allow-unconverged --quiet") == ""


@undrawn
def test_a_failed_solve_says_why_and_what_it_wrote(shell: Shell) -> None:
    shell.file()
    for quiet in ("", "--quiet"):
        out, err = shell.both(f"solve graph.g2o --gauge none --report p.html --json r.json {quiet}", 1)
        message, *advice = err.splitlines()
        assert out == ""
        assert "leave 3 directions free" in message
        assert len(advice) == 5
        assert advice[-2:] == ["  -> see: nls explain graph.g2o", "  -> written: p.html, r.json"]
        report = shell.json()
        assert (report["converged"], report["status"]) == (False, "UNDERCONSTRAINED")
        assert report["underconstrained"]
        assert report["written"] == ["p.html", "r.json"]
        assert "fix one pose of every part: --gauge first" in report["advice"]  # as it is typed
        page = Page((shell / "p.html").read_text())
        for text in ("Not solved", message.removeprefix("nls: "), "--gauge first"):
            assert text in page.text
        (shell / "r.json").unlink()
    shell.file(PLANE + RAY)
    _, err = shell.both("solve graph.g2o --robust gnc-tls --json r.json", 1)
    assert err.endswith("\n  -> see: nls explain graph.g2o\n  -> written: r.json\n")
    assert shell.json()["underconstrained"]


def test_landmarks_seen_once_are_free_one_by_one(shell: Shell) -> None:
    once = "".join(f"1,{k},4.0,{0.01 * (k - 30)!r},0.01,0.004\n" for k in range(20, 40))
    folder(shell / "m", contacts=TINY["contacts"] + once)
    out, report = shell.told("solve m")
    names = [text.split(":")[0] for text in rows(out, "free")]
    assert names == [*(f"l{k}" for k in range(20, 32)), "and 8 more directions"]
    assert not any(";" in text for text in rows(out, "free"))
    assert len(report["underconstrained"]) == 20
    assert "free: 20 directions" in row(out, "result")


@pytest.mark.filterwarnings("always")
def test_a_warning_is_said_once(shell: Shell) -> None:
    shell.file(PLANE + "UNKNOWN 1 2\n")
    for command in ("solve", "info"):
        out, err = shell.both(f"{command} graph.g2o")
        assert err.count("UNKNOWN") == 1
        assert "UNKNOWN" not in "".join(row for row in out.splitlines() if not row.startswith("  UNKNOWN"))
    assert any("UNKNOWN" in note for note in shell.report("solve graph.g2o")["notes"])


def test_covariances_of_sigmas_that_are_too_large_are_told(shell: Shell) -> None:
    twice = [(k, 1 + error) for k in range(20) for error in (-0.01, 0.01)]  # m; their sigma is 0.045 m
    shell.file("".join(f"EDGE_SE2 {k} {k + 1} {x} 0 0 {INFORMATION_2}\n" for k, x in twice))
    too_large = "all measurements: chi2 2 is 0.033 times its expectation of 60; sigmas about 5.5 times too large; "
    told = [
        any(note.startswith(too_large) for note in rows(shell(f"solve graph.g2o {option}"), "note"))
        for option in ("", "--covariance c.csv", "--covariance c.csv --sigmas estimate")
    ]
    assert told == [False, True, False]


def test_parts_that_nothing_joins_are_a_note_of_solve(shell: Shell) -> None:
    two = "the graph has 2 parts that no measurement connects (4 with x0, 2 with x10)"
    for text, count in ((PLANE + PART, 1), (PLANE, 0), (PLANE + PART + "FIX 0\nFIX 10\n", 0)):
        notes = rows(shell(f"solve {shell.file(text)}"), "note")
        assert sum(note.startswith(two) for note in notes) == sum("connects" in note for note in notes) == count


ENDS = np.r_[0.5:4:0.5, 16.5:20:0.5]  # s, of fixes at both ends
ORIGIN = "lat_deg,lon_deg\n54.0,10.0\n"


def fixes(t: np.ndarray, turn: float = 0.0, jump: float = 0.0) -> str:
    """Fixes of the track of `raw`, turned by an angle, one of them away by a jump."""
    p = np.outer(t, [np.cos(0.3 + turn), np.sin(0.3 + turn)])
    p[len(t) // 2] += jump
    names = ["time_s", "x_m", "y_m", "sigma_x_m", "sigma_y_m"]
    return csv_text(names, t, p, np.full((len(t), 2), 0.1)).decode()


def dive(path: Path, **tables: str) -> None:
    folder(path, raw() | {"origin": ORIGIN} | tables)


def mistaken(path: Path) -> None:
    """A dive with a heading 13 deg off."""
    dive(path, fixes=fixes(ENDS, np.radians(-13.0)))


@undrawn
@unwarned
def test_a_kernel_that_silences_a_sensor_is_loud(shell: Shell, untried: None) -> None:
    """Every output names the table, and `--allow-doubtful` ends with 0."""
    mistaken(shell / "m")
    words = "solve m --robust cauchy:1 -o out --report p.html --json r.json"
    out, err = shell.both(words, 1)
    report = shell.json()
    (reason,) = [reason for reason in report["doubtful"] if "Position (fixes.csv)" in reason]
    assert reason.startswith("the kernel ignored ")
    assert (report["converged"], report["fit"]) == (True, "IMPLAUSIBLE")
    (share,) = [share for share in report["ignored"] if share["table"] == "Position (fixes.csv)"]
    assert share["ignored"] > share["total"] / 4
    doubtful = f"nls: m: doubtful: {'; '.join(report['doubtful'])}; see: nls explain m --robust cauchy:1; or take"
    assert f"{doubtful} the estimate with --allow-doubtful" in err
    assert row(out, "result").endswith("; ".join(report["doubtful"]))
    assert (shell / "out" / "doubtful.txt").read_text().splitlines() == report["doubtful"]
    for text in ((shell / "out" / f"track.{form}").read_text() for form in ("kml", "geojson")):
        assert f"m, doubtful: {'; '.join(report['doubtful'])}" in text
    assert Page((shell / "p.html").read_text()).text.count("Doubtful") == 1
    shell.both(f"{words} --allow-doubtful")


@undrawn
@unwarned
def test_a_good_solution_is_not_marked_and_takes_the_mark_away(shell: Shell, untried: None) -> None:
    mistaken(shell / "m")
    shell.both("solve m --robust cauchy:1 -o out", 1)
    dive(shell / "n", fixes=fixes(ENDS))
    for kernel in ("", "--robust cauchy:1"):
        report = shell.report(f"solve n {kernel} -o out")
        assert (report["doubtful"], report["fit"]) == ([], "PLAUSIBLE")
        assert sum(table["ignored"] for table in report["ignored"]) == 0
        assert bool(report["ignored"]) == bool(kernel)
        assert report["ratio"] < 1
    assert not (shell / "out" / "doubtful.txt").exists()
    assert "doubtful" not in "".join((shell / "out" / f"track.{form}").read_text() for form in ("kml", "geojson"))


@unwarned
def test_findings_of_the_tables_are_doubts_of_every_mission(shell: Shell, untried: None) -> None:
    """Of one dive, and of several; outliers of a table that has a kernel are what that is for."""
    dive(shell / "m", fixes=fixes(np.arange(0.5, 20.0, 0.5)))
    dive(shell / "fast", dvl=raw()["dvl"].replace(",1.0,", ",1000.0,"), fixes=fixes(ENDS))
    dive(shell / "away", fixes=fixes(np.arange(0.5, 20.0, 0.5), jump=44.0))
    for words, doubted in (("m", []), ("fast", ["fast"]), ("m fast", ["fast"]), ("away", ["away"])):
        report = shell.report(f"solve {words} --allow-doubtful")
        assert bool(report["findings"]) == bool(doubted)
        assert any(reason.startswith("implausible: ") for reason in report["doubtful"]) == bool(doubted)
        shell.both(f"solve {words}", int(bool(doubted)))
    (finding,) = shell.report("solve away --allow-doubtful")["findings"]
    assert finding["file"] == "fixes.csv"
    assert shell.report("solve away --robust Position=cauchy:1")["doubtful"] == []
    assert shell.report("solve away --robust XYH=cauchy:1", 1)["doubtful"][0].startswith("implausible: ")


@unwarned
def test_a_kernel_is_judged_by_what_it_believes(shell: Shell) -> None:
    """One wrong closure of seven is for a kernel; the plain optimum is doubtful."""
    shell.file(SPOILED)
    shell.both("solve graph.g2o", 1)
    out = shell("solve graph.g2o --robust cauchy:1")
    assert row(out, "ignored") == "by the kernel: 0 of 7 Between of odometry, 1 of 8 Between closures (12.5 %)"
    assert "of the measurements the kernel keeps, 1 expected)" in row(out, "chi2")
    assert not any("implausible" in note for note in rows(out, "note"))


def test_a_picture_is_headed_by_its_doubts(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    figure.suptitle("dive")
    picture.write_picture(tmp_path / "a.png", figure)
    assert figure.get_suptitle() == "dive"
    picture.write_picture(tmp_path / "a.png", figure, ["one", "two"])
    assert figure.get_suptitle() == "dive\ndoubtful: one; two"


MORE = f"EDGE_SE2 0 2 2 1 1.55 {INFORMATION_2}\nEDGE_SE2 1 3 4 -3 1 {INFORMATION_2}\n"


@pytest.mark.parametrize(("text", "unknowns"), [(PLANE, 9), (SPACE, 12)], ids=["plane", "space"])
def test_the_words_and_the_numbers(text: str, unknowns: int, shell: Shell) -> None:
    out, report = shell.told(f"explain {shell.file(text)}")
    head, blank, first = out.splitlines()[:3]
    assert head.startswith("graph.g2o, at its optimum (gauss-newton, ")
    assert blank == ""
    assert first.startswith(f"{unknowns} unknowns, all determined. ")
    assert {"input", "init", "optimum", "summary", "rank", "findings", "parts", "worst", "weakest"} <= set(report)
    assert (report["rank"], report["nullity"], report["summary"]) == (unknowns, 0, first)
    graph, values, _ = nls.load("graph.g2o")
    assert report["chi2"] == pytest.approx(graph.optimize(nls.initialize(graph, values)[0]).chi2_final, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "where", "nullity", "first"),
    [
        (PLANE + MORE, "at its optimum (gauss-newton, ", 0, "wrong_closure"),
        (PLANE + PART, "at its optimum (gauss-newton, ", 0, "separate_parts"),
        (PLANE + RAY, "at its optimum (levenberg-marquardt, ", 1, "free"),
        (f"VERTEX_SE2 0 0 0 0\n{RAY}", "at the initial guess", 1, "not_converged"),  # no method starts
    ],
)
def test_what_is_found_is_no_failure(text: str, where: str, nullity: int, first: str, shell: Shell) -> None:
    report = shell.report(f"explain {shell.file(text)}")
    assert report["optimum"].startswith(where)
    assert (report["nullity"], report["findings"][0]["kind"]) == (nullity, first)


def test_kernels_and_kinds_that_are_held_as_in_solve(shell: Shell) -> None:
    shell.file(PLANE + MORE)
    options = ("", "--robust Between=tukey:3", "--hold x")
    plain, robust, held = (shell.report(f"explain graph.g2o {option}") for option in options)
    assert (plain["robust"], robust["robust"]) == (False, True)
    chi2 = {kind["name"]: kind["chi2"] for kind in robust["parts"]}
    assert chi2["Between, closures"] > 2 * plain["parts"][1]["chi2"]  # it is let go
    assert (plain["unknowns"], held["unknowns"]) == (9, 0)


@pytest.mark.parametrize("landmarks", [False, True], ids=["poses", "landmarks"])
def test_only_what_works_is_offered(landmarks: bool, shell: Shell) -> None:
    """Graduation wants loop closures and odometry, a certificate poses alone; else `nls solve` refuses."""
    rng = np.random.default_rng(0)
    lines = [f"VERTEX_SE2 {k} {k % 6} {k // 6} 0" for k in range(36)]
    lines += [f"EDGE_SE2 {k} {k + 1} {-5 if k % 6 == 5 else 1} {int(k % 6 == 5)} 0 {INFORMATION_2}" for k in range(35)]
    if landmarks:
        lines += [f"VERTEX_XY {100 + k} {k} 7" for k in range(4)]
        pairs = [(k, 100 + j, (j - k % 6, 7 - k // 6)) for k in range(36) for j in range(4)]
        tag, entries = "EDGE_SE2_XY", "500 0 500"
    else:
        pairs = [(k, k + 12, (0, 2)) for k in range(24)] * 3
        tag, entries = "EDGE_SE2", f"0 {INFORMATION_2}"
    for n, (i, j, (x, y)) in enumerate(pairs):
        dx, dy = (x, y) + 0.03 * rng.normal(size=2) if n % 3 else 5 * rng.normal(size=2)
        lines.append(f"{tag} {i} {j} {dx} {dy} {entries}")
    out = shell(f"explain {shell.file(chr(10).join(lines))} --init file")
    assert "most measurements are off alike" in out or "do not fit the others" in out
    offered = main(["solve", "graph.g2o", "--robust", "gnc-tls", "--quiet"]) != 2
    assert ("nls solve --robust gnc-tls" in out) == offered == (not landmarks)
    assert landmarks <= ("--certify" not in out)


def test_an_anchor_is_believed_in_one_line_and_none_where_no_file_has_it(shell: Shell) -> None:
    folder(shell / "m")
    out = shell("explain m")
    assert "RangeAzimuth" in out
    assert "gauge: fixed by the graph itself" in out
    line = "1. Position(x0), Heading(x0): taken as stated, no other measurement checks them [m/anchor.csv:2].\n\n"
    assert line in out
    assert out.count("anchor.csv:2") == 1
    assert "->" not in out
    (shell / "m" / "anchor.csv").unlink()
    folder(shell / "n", anchor=None)
    assert "no other measurement checks" not in shell("explain m --elevation free")
    assert "no other measurement checks" not in shell("explain m n")
