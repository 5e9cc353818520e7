"""Several missions as one graph: numbers, places, what they share, and what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls
import sim
from factors import Heading, Position, Prior
from models import euler
from nls import FactorGraph, GraphFileError, kinds
from nls.cli import main
from nls.missions import write_mission
from nls.missions.folder import dives as dives_module
from tests.nls.missions.folder.mission_files import TINY, folder, raw

x, l = kinds("x", "l")
HALF, OVERLAP = 123, 10
TRACK = {name: TINY[name] for name in ("odometry", "zpr")}
LEVEL = "x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n"
RANGES = "i,beacon,range_m,sigma_range_m\n0,1,10,1\n3,1,9,1\n"
BEACONS = "beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n1,9,4,6,0.1,0.1,0.1\n"


@pytest.fixture(scope="module")
def mission() -> sim.Mission:
    return sim.hauv_floor(np.random.default_rng(1))


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory, mission: sim.Mission) -> list[Path]:
    """The mission as two dives that overlap; the first has the anchor, the second none."""
    anchor = [f for f in mission.graph.factors if isinstance(f, Position | Heading)]
    places = [tmp_path_factory.mktemp("dives") / name for name in ("first", "second")]
    for place, held, low, high in zip(places, (anchor, []), (0, HALF - OVERLAP), (HALF, mission.poses), strict=True):
        graph = FactorGraph(held)
        for factor in (mission.odometry, mission.attitude, mission.contacts):
            poses = [keys.numbers for keys in factor.keys if keys.kind == "x"]
            graph.add(factor[np.flatnonzero(np.all([(n >= low) & (n < high) for n in poses], axis=0))])
        write_mission(place, graph, mission.sonar, mission.offset)
    return places


def test_a_dive_without_anchor_is_where_the_shared_landmarks_are(dives: list[Path], mission: sim.Mission) -> None:
    graph, values, report = nls.load(dives)
    assert [(dive.name, dive.first) for dive in report.dives] == [("first", 0), ("second", 1000)]
    places = {report.place(k, 0) for k, factor in enumerate(graph.factors) if len(factor)}
    assert {str(dive / "odometry.csv:2") for dive in dives} <= places
    assert len(report.sources) == len(graph.factors)
    result = graph.optimize(values)
    assert result.converged
    assert 0.9 < result.chi2_final / result.dof < 1.1
    truth = mission.truth[x][:, :3]
    expected = np.concatenate([truth[:HALF], truth[HALF - OVERLAP :]])
    away = np.linalg.norm(result.values[x][:, :3] - expected, axis=1)
    assert away.max() < 0.1  # 53 m of way; with contacts of its own alone the second would be anywhere
    graph, values, _ = nls.load(dives[::-1])  # the order does not matter
    assert graph.optimize(values).chi2_final == pytest.approx(result.chi2_final, rel=1e-5)


def test_dives_that_share_nothing_are_refused_and_those_with_anchors_are_not(tmp_path: Path) -> None:
    alone = folder(tmp_path / "alone", raw())
    other = folder(tmp_path / "tiny", TINY)
    with pytest.raises(GraphFileError, match=r"alone: its position relative to tiny is unknown.*anchor\.csv"):
        nls.load([other, alone])
    folder(alone, {}, anchor=f"i,{LEVEL}0,5,6,0,0.1,0.1,0.1\n")
    _, values, _ = nls.load([other, alone])
    assert euler.from_se3(values[x[100]])[3:5] == pytest.approx([5, 6])


def test_dives_with_other_landmarks_of_equal_numbers_are_refused(dives: list[Path], tmp_path: Path) -> None:
    other = Path(shutil.copytree(dives[1], tmp_path / "other"))
    header, *rows = (other / "contacts.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    numbers = np.random.default_rng(2).permutation(1 + max(int(landmark) for _, landmark, *_ in cells))
    rows = [",".join([i, str(numbers[int(landmark)]), *rest]) for i, landmark, *rest in cells]
    (other / "contacts.csv").write_text("\n".join([header, *rows, ""]))
    (other / "anchor.csv").write_text((dives[0] / "anchor.csv").read_text().replace("\n0,", "\n113,"))
    with pytest.raises(GraphFileError, match=r"other: \d+ of its landmarks have numbers of first but other places"):
        nls.load([dives[0], other])


def test_the_same_landmarks_are_not_refused_however_small_their_map(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sixty piles in a square of two meters, off by half a meter, and turned by a compass that is wrong."""
    rng = np.random.default_rng(0)
    at = rng.uniform(-1, 1, (60, 2))
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    pairs = [at + rng.normal(0, 0.3, at.shape), at @ turn + rng.normal(0, 0.3, at.shape)]
    monkeypatch.setattr(dives_module, "_shared", lambda *_: pairs)
    reads: Any = [(None, None, None), (None, None, SimpleNamespace(path="b"))]
    dives_module._refuse_other_landmarks(reads, ["a", "b"])
    pairs[1] = rng.permutation(pairs[1])
    with pytest.raises(GraphFileError, match="60 of its landmarks have numbers of a but other places"):
        dives_module._refuse_other_landmarks(reads, ["a", "b"])


def test_refusals(tmp_path: Path) -> None:
    a, b = folder(tmp_path / "a", TINY), folder(tmp_path / "b", TINY)
    with pytest.raises(GraphFileError, match="is given twice"):
        nls.load([a, tmp_path / "b" / ".." / "a"])
    with pytest.raises(GraphFileError, match="is no folder"):
        nls.load([a, a / "zpr.csv"])
    folder(a, {}, origin="lat_deg,lon_deg\n54.1,10.2\n")
    folder(b, {}, origin="lat_deg,lon_deg\n54.1,10.3\n")
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
    return f"i,dive,j,{LEVEL}{i},{dive},{j},0,0,0,0.01,0.01,0.01\n"


def test_a_closure_between_dives(tmp_path: Path) -> None:
    """Two tracks with anchors of their own meters apart: the closure brings the poses together, as the sigmas say."""
    a = folder(tmp_path / "a", TRACK, anchor=f"i,{LEVEL}0,0,0,0,1,1,0.1\n")
    b = folder(tmp_path / "b", TRACK, anchor=f"i,{LEVEL}0,3,0,0,1,1,0.1\n", dive_closures=closures("a", 2, 2))
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
    with pytest.raises(GraphFileError, match=message):
        nls.load([folder(tmp_path / "a"), folder(tmp_path / "b", dive_closures=text)])


@pytest.mark.usefixtures("undrawn")
def test_the_command_line_writes_a_map_and_a_track_of_each(
    dives: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "out", tmp_path / "report.json"
    assert main(["solve", *map(str, dives), "-o", str(out), "--json", str(report)]) == 0
    assert "dive        second: 134 poses over" in capsys.readouterr().out
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
    assert all(words in out for words in ("no optimum was found (no number)", "\nXYH, a ", "\nXYH, b "))


def test_one_survey_of_a_beacon_counts_once_and_two_that_contradict_are_refused(tmp_path: Path) -> None:
    a, b = (folder(tmp_path / name, TRACK, beacons=BEACONS, ranges=RANGES) for name in "ab")
    graph, _, report = nls.load([a, b])
    priors = [f for f in graph.factors if isinstance(f, Prior) and f.keys[0].kind == "b"]
    assert [len(prior) for prior in priors] == [1]
    assert len(report.sources) == len(graph.factors)
    assert any("b: beacons.csv has 1 rows that another dive has, too" in note for note in report.notes)
    folder(b, {}, beacons=BEACONS.replace("1,9,4", "1,9,7"))
    with pytest.raises(GraphFileError, match=r"b/beacons\.csv:2: beacon 1 is 3 m from where .*a/beacons\.csv:2 has it"):
        nls.load([a, b])


def test_beacons_are_compared_where_both_dives_measure_them(tmp_path: Path) -> None:
    """A depth alone beside a place: no contradiction at one depth, one at another, and the depth counts once."""
    depth, anchor = "beacon,z_m,sigma_z_m\n1,{},0.1\n", f"i,{LEVEL}0,0,0,0,1,1,0.1\n"
    beacons = {"a": depth.format(6.1), "b": BEACONS, "c": depth.format(6.1)}
    dives = [folder(tmp_path / k, TRACK, anchor=anchor, beacons=v, ranges=RANGES) for k, v in beacons.items()]
    graph, _, _ = nls.load(dives)
    assert [f.components for f in graph.factors if isinstance(f, Prior) and f.keys[0].kind == "b"] == [("z",), None]
    folder(dives[0], {}, beacons=depth.format(7))
    with pytest.raises(GraphFileError, match=r"b/beacons\.csv:2: beacon 1 is 1 m from where .*a/beacons\.csv:2 has it"):
        nls.load(dives)


def test_a_closure_places_a_dive_without_an_anchor(tmp_path: Path) -> None:
    """Pose 12 of one dive is pose 2 of the other, so their tracks lie on each other, from whichever side it is said."""
    for side, (i, j) in {"a": (1, 2), "b": (2, 1)}.items():
        places = []
        (tmp_path / side).mkdir()
        for name, other, anchor in (("a", "b", f"i,{LEVEL}0,30,-7,2,0.01,0.01,0.01\n"), ("b", "a", None)):
            closed = closures(other, i, j) if name == side else None
            places.append(folder(tmp_path / side / name, TRACK, anchor=anchor, dive_closures=closed))
        graph, values, _ = nls.load(places)
        assert np.linalg.norm(values[x[1]][:2] - values[x[12]][:2]) < 0.02
        result = graph.optimize(values)
        assert result.converged
        assert result.chi2_final < 1e-3
