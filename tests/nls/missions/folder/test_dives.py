"""Several missions as one graph: numbers, places, what they share, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import Heading, Position, Prior
from models import euler
from nls import FactorGraph, GraphFileError, kinds
from nls.cli import main
from nls.missions import write_mission
from nls.missions.folder.dives import DivesReport
from tests.nls.missions.folder.mission_files import TINY, folder, raw

x, l = kinds("x", "l")
HALF, OVERLAP = 123, 10


@pytest.fixture(scope="module")
def mission() -> sim.Mission:
    return sim.hauv_floor(np.random.default_rng(1))


def written(place: Path, mission: sim.Mission, low: int, high: int, anchors: FactorGraph) -> Path:
    """Poses low to high of a mission as a dive of its own."""
    graph = FactorGraph(anchors.factors)
    for factor in (mission.odometry, mission.attitude, mission.contacts):
        poses = [keys.numbers for keys in factor.keys if keys.kind == "x"]
        inside = np.flatnonzero(np.all([(n >= low) & (n < high) for n in poses], axis=0))
        graph.add(factor[inside])
    write_mission(place, graph, mission.sonar, mission.offset)
    return place


@pytest.fixture
def dives(tmp_path: Path, mission: sim.Mission) -> list[Path]:
    """The mission as two dives that overlap; the first has the anchor, the second none."""
    anchor = FactorGraph([f for f in mission.graph.factors if isinstance(f, Position | Heading)])
    first = written(tmp_path / "first", mission, 0, HALF, anchor)
    return [first, written(tmp_path / "second", mission, HALF - OVERLAP, mission.poses, FactorGraph())]


def test_a_dive_without_anchor_is_where_the_shared_landmarks_are(dives: list[Path], mission: sim.Mission) -> None:
    graph, values, report = nls.load(dives)
    assert isinstance(report, DivesReport)
    assert [(dive.name, dive.first) for dive in report.dives] == [("first", 0), ("second", 1000)]
    assert len(values.stack("x")) == mission.poses + OVERLAP
    result = graph.optimize(values)
    assert result.converged
    assert 0.9 < result.chi2_final / result.dof < 1.1
    optimum = result.values
    truth = mission.truth[x]
    second = optimum.stack("x").numbers >= 1000
    poses = np.asarray(optimum.stack("x").X)
    errors = np.linalg.norm(poses[second][:, :3] - truth[HALF - OVERLAP :, :3], axis=1)
    assert errors.max() < 0.1  # 53 m of way; with contacts of its own alone it would be anywhere
    assert np.linalg.norm(poses[~second][:, :3] - truth[:HALF, :3], axis=1).max() < 0.1


def test_lines_are_those_of_the_files_of_each_dive(dives: list[Path]) -> None:
    graph, _, report = nls.load(dives)
    places = {report.place(k, 0) for k, factor in enumerate(graph.factors) if len(factor)}
    assert {str(dives[0] / "odometry.csv:2"), str(dives[1] / "odometry.csv:2")} <= places
    assert len(report.sources) == len(graph.factors)


def test_the_order_of_the_dives_does_not_matter(dives: list[Path]) -> None:
    chi2 = [graph.optimize(values).chi2_final for graph, values, _ in (nls.load(dives), nls.load(dives[::-1]))]
    assert chi2[0] == pytest.approx(chi2[1], rel=1e-5)


def test_dives_that_share_nothing_are_refused_and_those_with_anchors_are_not(tmp_path: Path) -> None:
    alone = folder(tmp_path / "alone", raw())
    other = folder(tmp_path / "tiny", TINY)
    with pytest.raises(GraphFileError, match=r"alone: nothing says where this dive is beside tiny.*anchor\.csv"):
        nls.load([other, alone])
    (alone / "anchor.csv").write_text("i,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n0,5,6,0,0.1,0.1,0.1\n")
    _, values, _ = nls.load([other, alone])
    assert euler.from_se3(values[x[100]])[3:5] == pytest.approx([5, 6])


def test_refusals(tmp_path: Path) -> None:
    a, b = folder(tmp_path / "a", TINY), folder(tmp_path / "b", TINY)
    with pytest.raises(GraphFileError, match="is given twice"):
        nls.load([a, tmp_path / "b" / ".." / "a"])
    with pytest.raises(GraphFileError, match="is no folder"):
        nls.load([a, a / "zpr.csv"])
    (a / "origin.csv").write_text("lat_deg,lon_deg\n54.1,10.2\n")
    (b / "origin.csv").write_text("lat_deg,lon_deg\n54.1,10.3\n")
    with pytest.raises(GraphFileError, match=r"54\.1, 10\.3 deg.*one origin\.csv"):
        nls.load([a, b])
    with pytest.raises(nls.OptionError, match="several missions"):
        nls.load([a])


def test_landmarks_are_the_same_and_poses_are_not(tmp_path: Path) -> None:
    graph, values, _ = nls.load([folder(tmp_path / "a", TINY), folder(tmp_path / "b", TINY)])
    assert values.stack("x").numbers.tolist() == [0, 1, 2, 3, 10, 11, 12, 13]
    assert values.stack("l").numbers.tolist() == [11, 12, 14]
    one = nls.load(tmp_path / "a")
    optimum = graph.optimize(values)
    assert optimum.chi2_final == pytest.approx(2 * one[0].optimize(one[1]).chi2_final, rel=1e-6)


def closures(dive: str, i: int, j: int) -> str:
    names = "i,dive,j,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad"
    return f"{names}\n{i},{dive},{j},0,0,0,0.01,0.01,0.01\n"


def test_a_closure_between_dives(tmp_path: Path) -> None:
    """Two tracks with anchors of their own meters apart: the closure brings the poses together, as the sigmas say."""
    anchor = "i,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n0,{},0,0,1,1,0.1\n"
    track = {name: TINY[name] for name in ("odometry", "zpr")}
    a = folder(tmp_path / "a", track, anchor=anchor.format(0))
    b = folder(tmp_path / "b", track, anchor=anchor.format(3), dive_closures=closures("a", 2, 2))
    graph, values, report = nls.load([a, b])
    result = graph.optimize(values).values
    assert np.linalg.norm(result[x[2]][:2] - result[x[12]][:2]) < 0.1
    assert result[x[0]][0] == pytest.approx(1.5, abs=0.1)  # in the middle of both anchors
    assert report.place(len(graph.factors) - 1, 0) == str(b / "dive_closures.csv:2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (closures("c", 2, 2), r"dive_closures\.csv:2: dive is 'c'; expected one of the others .*: a"),
        (closures("b", 2, 2), r"dive is 'b'"),
        (closures("a", 2, 7), r"j is 7; the track of that dive has no such pose"),
        (closures("a", 7, 2), r"i is 7"),
    ],
)
def test_damaged_closures_between_dives(text: str, message: str, tmp_path: Path) -> None:
    a = folder(tmp_path / "a", TINY)
    b = folder(tmp_path / "b", TINY, dive_closures=text)
    with pytest.raises(GraphFileError, match=message):
        nls.load([a, b])


def test_the_command_line_writes_a_map_and_a_track_of_each(
    dives: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "out", tmp_path / "report.json"
    assert main(["solve", *map(str, dives), "-o", str(out), "--json", str(report)]) == 0
    shown = capsys.readouterr().out
    assert "dive        second: 134 poses over" in shown
    mission = json.loads(report.read_text())["mission"]
    assert [dive["name"] for dive in mission["dives"]] == ["first", "second"]
    assert mission["distance_m"] == pytest.approx(sum(dive["distance_m"] for dive in mission["dives"]))
    assert {path.name for path in out.iterdir()} == {"first", "second", "map.csv", "map.ply", "landmarks.png"}
    rows = np.genfromtxt(out / "second" / "trajectory.csv", delimiter=",", names=True)
    assert rows["i"].tolist() == list(range(1113, 1247))
    assert (rows["sigma_x_m"] > 0).all()
    assert main(["explain", *map(str, dives)]) == 0
    rows = [line.split(",")[:2] for line in capsys.readouterr().out.splitlines() if line.startswith("RangeAzimuth, ")]
    assert [row[1].split()[0] for row in rows] == ["first", "second"]
    assert main(["solve", *map(str, dives), "-o", str(dives[1])]) == 2


def test_explain_counts_dives_apart_where_there_is_no_optimum(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise nls.EvaluationError("no number")

    a, b = folder(tmp_path / "a", TINY), folder(tmp_path / "b", TINY)
    monkeypatch.setattr(FactorGraph, "optimize", refused)
    assert main(["explain", str(a), str(b)]) == 0
    out = capsys.readouterr().out
    assert "no optimum was found (no number)" in out
    assert "\nXYH, a " in out
    assert "\nXYH, b " in out


def test_one_survey_of_a_beacon_counts_once_and_two_that_contradict_are_refused(tmp_path: Path) -> None:
    beacons = "beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n1,9,4,6,0.1,0.1,0.1\n"
    ranges = "i,beacon,range_m,sigma_range_m\n0,1,10,1\n3,1,9,1\n"
    track = {name: TINY[name] for name in ("odometry", "zpr")}
    a = folder(tmp_path / "a", track, beacons=beacons, ranges=ranges)
    b = folder(tmp_path / "b", track, beacons=beacons, ranges=ranges)
    graph, _, report = nls.load([a, b])
    priors = [f for f in graph.factors if isinstance(f, Prior) and f.keys[0].kind == "b"]
    assert [len(prior) for prior in priors] == [1]
    assert len(report.sources) == len(graph.factors)
    assert any("b: beacons.csv has 1 rows that another dive has, too" in note for note in report.notes)
    (b / "beacons.csv").write_text(beacons.replace("1,9,4", "1,9,7"))
    with pytest.raises(GraphFileError, match=r"b/beacons\.csv:2: beacon 1 is 3 m from where .*a/beacons\.csv:2 has it"):
        nls.load([a, b])


def test_beacons_are_compared_where_both_dives_measure_them(tmp_path: Path) -> None:
    """A depth alone beside a place: no contradiction at one depth, one at another, and the depth counts once."""
    depth, place = (
        "beacon,z_m,sigma_z_m\n1,{},0.1\n",
        "beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n1,9,4,6,1,1,0.1\n",
    )
    ranges = "i,beacon,range_m,sigma_range_m\n0,1,10,1\n3,1,9,1\n"
    track = {name: TINY[name] for name in ("odometry", "zpr")}
    anchor = "i,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n0,0,0,0,1,1,0.1\n"
    beacons = {"a": depth.format(6.1), "b": place, "c": depth.format(6.1)}
    dives = [folder(tmp_path / k, track, anchor=anchor, beacons=v, ranges=ranges) for k, v in beacons.items()]
    graph, _, _ = nls.load(dives)
    assert [f.components for f in graph.factors if isinstance(f, Prior) and f.keys[0].kind == "b"] == [("z",), None]
    (dives[0] / "beacons.csv").write_text(depth.format(7))
    with pytest.raises(GraphFileError, match=r"b/beacons\.csv:2: beacon 1 is 1 m from where .*a/beacons\.csv:2 has it"):
        nls.load(dives)


def test_a_closure_places_a_dive_without_an_anchor(tmp_path: Path) -> None:
    """Pose 12 of one dive is pose 2 of the other, so their tracks lie on each other, from whichever side it is said."""
    track = {name: TINY[name] for name in ("odometry", "zpr")}
    anchor = "i,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n0,30,-7,2,0.01,0.01,0.01\n"
    for side, (i, j) in {"a": (1, 2), "b": (2, 1)}.items():
        place = tmp_path / side
        place.mkdir()
        text = closures("b" if side == "a" else "a", i, j)
        a = folder(place / "a", track, anchor=anchor, **({"dive_closures": text} if side == "a" else {}))
        b = folder(place / "b", track, **({"dive_closures": text} if side == "b" else {}))
        graph, values, _ = nls.load([a, b])
        pair = (x[1], x[12])
        assert np.linalg.norm(values[pair[0]][:2] - values[pair[1]][:2]) < 0.02
        result = graph.optimize(values)
        assert result.converged
        assert result.chi2_final < 1e-3
