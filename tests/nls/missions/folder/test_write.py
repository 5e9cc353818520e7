"""Graphs as mission folders: numbers bit for bit, and a refusal for what no file has columns for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
from factors import (
    XYH,
    ZPR,
    Bearing,
    Between,
    Cauchy,
    Covariance,
    Diagonal,
    Factor,
    Heading,
    Huber,
    Isotropic,
    Position,
    Prior,
    Range,
    RangeAzimuth,
    sonar_factors,
)
from models import SE3, R, euler
from models.sensors import DIDSON_HIGH
from nls import FactorGraph, GraphError, GraphFileError, Values
from nls.missions import read_mission, write_mission
from nls.missions.folder.table import Table, csv_text
from tests.combinations import for_all
from tests.nls.missions.folder.mission_files import TINY, folder

x, l, b = nls.kinds("x", "l", "b")
OFFSET = euler.to_se3([0.1, -0.6, 0.2, 0.3, 0.0, 0.1])
AWKWARD = [0.1 + 0.2, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, 1e22, 1e23, 123456789012345678.0, -1e-7]


def track(rng: np.random.Generator) -> list[Any]:
    """Steps, depth and tilt of poses with large and negative numbers, sigmas of every form."""
    z = rng.normal(size=(3, 3))
    i, j = x[[-5, 0, 7]], x[[0, 7, 2**60]]
    return [
        XYH(i, j, z, Diagonal(yaw=rng.uniform(0.1, 1, 3), x=0.1, y=[0.1, 0.2, 0.3])),
        XYH(x[-5], x[7], z[0], Isotropic(0.25)),
        ZPR(x[[-5, 0, 7, 2**60]], 0.1 * rng.normal(size=(4, 3)), Diagonal(rng.uniform(0.1, 1, (4, 3)))),
    ]


@pytest.mark.parametrize("given", ["made", "tiny"])
def test_what_is_written_is_read_bit_for_bit(given: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    z = np.column_stack([rng.uniform(1, 6, 5), rng.uniform(-0.2, 0.2, 5)])
    contacts = sonar_factors(x[[-5, 0, 7, 0, 7]], l[[3, 3, 3, 9, 9]], z, None, DIDSON_HIGH, OFFSET)
    anchor = [
        Position(x[0], [1 / 3, -2.0], Isotropic(1e-3), components=("x", "y")),
        Heading(x[0], 0.1 + 0.2, Isotropic(1e-4)),
    ]
    graph = FactorGraph([*track(rng), *anchor, *contacts])
    X = euler.to_se3(rng.normal(size=(4, 6)) * 0.1)
    truth = Values({x: (SE3, X, [7, 0, -5, 2**60]), l: (R(3), rng.normal(size=(2, 3)), [9, 3])})
    times = [0.5, -1.1, 2.3, 1e9]
    if given == "tiny":
        folder(tmp_path / "a", poses="i,time_s\n0,1.0\n1,2.0\n2,3.0\n3,4.5\n")
    else:
        files = write_mission(tmp_path / "a", graph, DIDSON_HIGH, OFFSET, truth, times)
        assert [Path(file).name for file in files] == [f"{name}.csv" for name in (*TINY, "poses")]
    again, values, report = read_mission(tmp_path / "a")
    if given == "made":
        assert report.sonar == DIDSON_HIGH
        assert SE3.local(report.offset, OFFSET) == pytest.approx(np.zeros(6), abs=1e-15)
        assert report.vertex_times["x"].tolist() == times
        assert np.array_equal(report.truth[l[[9, 3]]], truth[l[[9, 3]]])
        assert report.truth[x[[7, 0, -5]]] == pytest.approx(X[:3], abs=1e-15)
        steps = again.factors[0]
        assert steps.z.tolist() == [*graph.factors[0].z.tolist(), graph.factors[1].z.tolist()]
        assert steps.keys == (x[[-5, 0, 7, -5]], x[[0, 7, 2**60, 7]])
        assert again.factors[1].z.tolist() == graph.factors[2].z.tolist()
        assert again.factors[4].z.tolist() == z.tolist()
        assert again.factors[4].noise.sigmas.tolist() == [DIDSON_HIGH.noise_sigmas.tolist()] * 5
        assert again.chi2(values) == pytest.approx(graph.chi2(values), rel=1e-12)
    write_mission(tmp_path / "b", again, report.sonar, report.offset, report.truth, report.vertex_times["x"])
    for name in (*TINY, "poses"):
        one, two = ((tmp_path / where / f"{name}.csv").read_text() for where in "ab")
        if name == "truth":  # angles go through a quaternion
            rows = [np.loadtxt(text.splitlines()[1:], delimiter=",") for text in (one, two)]
            assert rows[0] == pytest.approx(rows[1], abs=1e-15)
        elif name != "sonar":
            assert one == two


def test_a_prior_is_an_anchor_too(tmp_path: Path) -> None:
    start = euler.to_se3([0.1, 0.2, 0.5, 1.0, 2.0, 3.0])
    prior = Prior(x[0], start, Diagonal(yaw=0.01, x=0.1, y=0.2), components=("x", "y", "yaw"))
    write_mission(tmp_path / "m", FactorGraph([*track(np.random.default_rng(6)), prior]))
    row = (tmp_path / "m" / "anchor.csv").read_text().splitlines()[1].split(",")
    assert [float(cell) for cell in row] == pytest.approx([0, 1.0, 2.0, 0.5, 0.1, 0.2, 0.01])


@for_all(anchored=[True, False])
def test_headings_of_a_compass_come_back(anchored: bool, tmp_path: Path) -> None:
    """In the rows of their poses; the heading of an anchor is another one, also where it is of all poses."""
    places = [tmp_path / f"{name}{anchored}" for name in "mn"]
    rng = np.random.default_rng(7)
    yaw, sigma, poses = rng.uniform(-3, 3, 4), rng.uniform(0.1, 1, 4), x[[-5, 0, 7, 2**60]]
    compass = [Heading(poses[rows], yaw[rows], Diagonal(sigma[rows, None])) for rows in ([2, 0], [3, 1])]
    anchor = [
        Position(poses, rng.normal(size=(4, 2)), Isotropic(1e-3), components=("x", "y")),
        Heading(poses, rng.uniform(-3, 3, 4), Isotropic(1e-4)),
    ]
    write_mission(places[0], FactorGraph([*track(rng), *compass, *anchor[: 2 * anchored]]))
    graph, _, _ = read_mission(places[0])
    first, *others = (factor for factor in graph.factors if isinstance(factor, Heading))
    assert first.keys == (poses,)
    assert (first.z.ravel().tolist(), first.noise.sigmas.ravel().tolist()) == (yaw.tolist(), sigma.tolist())
    assert [h.z.ravel().tolist() for h in others] == [anchor[1].z.ravel().tolist()] * anchored
    write_mission(places[1], graph)
    for name in ("zpr", "anchor")[: 1 + anchored]:
        assert len({(place / f"{name}.csv").read_text() for place in places}) == 1


def test_numbers_of_every_size_come_back(tmp_path: Path) -> None:
    file = tmp_path / "depth.csv"
    file.write_bytes(csv_text(["time_s", "z_m"], np.array([AWKWARD, AWKWARD[::-1]]).T))
    found = Table(file, ["time_s", "z_m"]).floats("z_m", "time_s")
    assert found.tobytes() == np.array([AWKWARD[::-1], AWKWARD]).T.tobytes()
    with pytest.raises(GraphError, match="z_m: a number is not finite"):
        csv_text(["i", "z_m"], [1], [[np.inf]])


STEP = XYH(x[0], x[1], [1, 0, 0], Isotropic(1))
TILT = ZPR(x[[0, 1]], np.zeros((2, 3)), Isotropic(1))
SEEN = RangeAzimuth(x[0], l[0], [3, 0], Isotropic(1))
TRACK = [
    XYH(x[[0, 1]], x[[1, 2]], [[1, 0, 0.1], [1, 0.1, 0]], Isotropic(0.1)),
    ZPR(x[[0, 1, 2]], np.zeros((3, 3)), Isotropic(0.01)),
]
ARM = np.array([0.3, -0.1, 0.2])
MOUNT = np.append(ARM, [0, 0, 0, 1.0])
PLACES = Position(x[[0, 2]], [[1, 2, 3], [4, 5, 6.0]], Diagonal(z=1.0, x=0.5, y=0.1), offset=ARM)
FACTORS: list[Factor] = [
    PLACES,
    PLACES.robust(Huber(1.5)),
    Between(x[0], x[2], euler.to_se3([0.1, -0.2, 0.3, 1, 2, 3]), Diagonal(np.arange(1.0, 7.0))).robust(Cauchy(0.1)),
    Prior(b[[5, 7]], [[1, 2, 3], [4, 5, 6.0]], Isotropic([0.1, 0.2])),
    Range(x[[0, 1]], b[[5, 7]], [3.0, 1 / 3], Diagonal(range=[0.1, 0.2]), MOUNT),
]


def test_factors_go_round(tmp_path: Path) -> None:
    graph = FactorGraph([*TRACK, *FACTORS])
    files = write_mission(tmp_path / "m", graph)
    assert [Path(f).name for f in files][2:] == ["fixes.csv", "closures.csv", "beacons.csv", "ranges.csv"]
    again, start, _ = nls.load(tmp_path / "m")
    assert [type(factor) for factor in again.factors] == [type(factor) for factor in graph.factors]
    assert [factor.kernel for factor in again.factors] == [factor.kernel for factor in graph.factors]
    for factor, same in zip(graph.factors, again.factors, strict=True):
        model, other = (start.gather(f)[0] for f in (factor, same))
        assert [keys.numbers.tolist() for keys in factor.keys] == [keys.numbers.tolist() for keys in same.keys]
        assert other.z == pytest.approx(np.broadcast_to(model.z, other.z.shape), abs=1e-15)
        assert factor.chi2(start) == pytest.approx(same.chi2(start), rel=1e-12)
    assert "kernel" not in (tmp_path / "m" / "ranges.csv").read_text()  # no column that says nothing


REFUSED: list[tuple[list[Any], str]] = [
    ([TILT], r"the graph has no factors for odometry\.csv; a mission needs XYH and ZPR"),
    ([STEP], r"the graph has no factors for zpr\.csv"),
    ([STEP, TILT, SEEN], "the graph has contacts; give the sonar that saw them"),
    ([STEP, TILT, Bearing(x[0], l[0], [[0, 0]], Isotropic(1))], r"Bearing\(x0, l0\) has no file in a mission folder"),
    ([STEP.robust(Huber(1.0)), TILT], r"XYH\(x0, x1\) has no file .* a robust kernel"),
    ([XYH(x[0], x[1], [1, 0, 0], Isotropic(1), "relative"), TILT], "odometry.csv holds the levelled form"),
    ([XYH(x[0], x[1], [1, 0, 0], Covariance(np.eye(3))), TILT], "its noise is Covariance; files hold standard dev"),
    ([STEP, ZPR(l[0], [0, 0, 0], Isotropic(1))], r"its variables are \['l'\], expected \['x'\]"),
    ([STEP, TILT, RangeAzimuth(x[0], l[0], [3, 0], Isotropic(1), OFFSET)], "its offset is not the one given"),
    ([STEP, TILT, RangeAzimuth(x[0], l[0], [3, 0], Isotropic(1), x[1])], r"its variables are \['x', 'l', 'x'\]"),
    ([STEP, TILT, Prior(x[0], SE3.identity()[0], Isotropic(1))], r"anchor\.csv holds x, y and yaw: components="),
    ([STEP, TILT, Position(x[0], 0, Isotropic(1), ("y",))], "a Position of x and y, and a Heading of"),
    ([STEP, TILT, ZPR(x[2], [0, 0, 0], Isotropic(1))], r"x2 is in zpr\.csv, but no XYH connects it to the track"),
    ([STEP, TILT, TILT], r"x0 is measured twice in zpr\.csv; expected once"),
    ([STEP, TILT, Heading(x[0], 0.0, Isotropic(1))], r"Heading\(x0\) has no file .* every pose, once: not for x1; one"),
    ([STEP, TILT, Heading(x[[0, 1, 1]], [0, 0, 0], Isotropic(1))], r"for every pose, once: not for x1"),
    ([STEP, TILT, Heading(x[[0, 1, 2]], [0, 0, 0], Isotropic(1))], r"for every pose, once: not for x2"),
    ([STEP, TILT, Position(x[0], 0, Isotropic(1), ("z",)), Heading(x[0], 0, Isotropic(1))], r"Position\(x0\) has no"),
    ([*TRACK, PLACES, Position(x[1], [1, 2], Isotropic(1), ("x", "y"))], r"has other columns of fixes\.csv"),
    ([*TRACK, Range(x[0], b[5], 3.0, Isotropic(1), SE3.exp([0, 0, 0, 0, 0.1, 0]))], "for the attitude of a sensor"),
    ([*TRACK, Between(x[0], x[2], SE3.identity(), Covariance(np.eye(6)))], "its noise is Covariance"),
    ([*TRACK, FACTORS[3], FACTORS[3]], "a beacon has two priors"),
    ([*TRACK, FACTORS[3].robust(Huber(1.0))], r"beacons\.csv has no column for a robust kernel"),
    ([*TRACK, Position(x[9], [1, 2], Isotropic(1), ("x", "y"))], r"x9 is in fixes\.csv, but no XYH"),
    ([*TRACK, Between(x[0], x[2], SE3.identity(), Isotropic(1), "g2o")], "has no file in a mission folder"),
]


@for_all(case=REFUSED)
def test_factors_without_a_file_are_refused_before_anything_is_written(
    case: tuple[list[Any], str], tmp_path: Path
) -> None:
    with pytest.raises(GraphError, match=case[1]):
        write_mission(tmp_path / "m", FactorGraph(case[0]))
    assert not (tmp_path / "m").exists()


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    graph = FactorGraph([STEP, TILT])
    graph.fix(x[[1, 0]])
    with pytest.raises(GraphError, match="x1 is fixed, which no file"):
        write_mission(tmp_path / "m", graph)
    assert not (tmp_path / "m").exists()
    graph.fixed = []
    (tmp_path / "file").write_text("")
    for name in ("file", "file/inside"):
        with pytest.raises(GraphFileError, match="cannot be made: "):
            write_mission(tmp_path / name, graph)
    here = folder(tmp_path / "m")
    before = {path.name: path.read_text() for path in here.iterdir()}
    with pytest.raises(GraphFileError, match=r"sonar\.csv: is of another mission, which would be mixed with this one"):
        write_mission(here, graph)
    assert {path.name: path.read_text() for path in here.iterdir()} == before
    for name in before.keys() - {"odometry.csv", "zpr.csv"}:
        (here / name).unlink()
    write_mission(here, graph)
    assert len(nls.load(here)[0]) == 1 + 2 + 2


def test_the_name_of_a_sonar_and_the_times_of_poses(tmp_path: Path) -> None:
    graph = FactorGraph([STEP, TILT, RangeAzimuth(x[0], l[0], [3.0, 0.1], Isotropic(0.1))])
    for name in ('a "good", one', "plain", "", ",", '"', "Ärger"):
        write_mission(tmp_path / "m", graph, replace(DIDSON_HIGH, name=name))
        assert nls.load(tmp_path / "m")[2].sonar.name == name
    for given, words, problem in (
        ([STEP, TILT], {"sonar": DIDSON_HIGH}, "the graph has no contacts; leave the sonar out"),
        (graph.factors, {"sonar": replace(DIDSON_HIGH, name="a\nb")}, "has more than one line"),
        ([STEP, TILT], {"times": [0.0, 1.1, 2.3]}, r"times of shape \(3,\), expected \(2,\): one of its own for each"),
        ([STEP, TILT], {"times": [1.1, 1.1]}, "one of its own for each pose"),
    ):
        with pytest.raises(GraphError, match=problem):
            write_mission(tmp_path / "m", FactorGraph(given), **words)


def test_factors_without_measurements_have_no_rows(tmp_path: Path) -> None:
    seen = Bearing(x[0], l[0], [[0, 0]], Isotropic(1))
    nothing = [factor[np.zeros(0, dtype=int)] for factor in (STEP, SEEN, TILT, PLACES, seen)]
    files = write_mission(tmp_path / "m", FactorGraph([*nothing, STEP, TILT, *nothing]))
    assert [Path(file).name for file in files] == ["odometry.csv", "zpr.csv"]
    assert len((tmp_path / "m" / "odometry.csv").read_text().splitlines()) == 2
