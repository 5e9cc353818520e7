"""Contacts of a time are of its pose; those without landmarks are read, solved, or refused by name."""

from __future__ import annotations

import re
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import Elevation, ElevationHinge, RangeAzimuth
from models.errors import GraphFileError, GraphWarning, OptionError
from nls import FactorGraph, Values, kinds
from nls.cli import main
from nls.filters.association import pair_precision_recall
from nls.io.report import LoadReport
from nls.missions import associated
from nls.missions.folder.write import mission_files
from tests.nls.io.g2o_files import PLANE
from tests.nls.missions.folder.mission_files import TINY, folder
from tests.nls.missions.scans import room_files

x, l = kinds("x", "l")


@cache
def mission() -> sim.Mission:
    """One leg over the sea floor, there and back."""
    return sim.hauv_floor(np.random.default_rng(1), legs=1, per_leg=8)


@cache
def files() -> dict[str, str]:
    """The mission as files, with names."""
    given = mission()
    made = mission_files(given.graph, given.sonar, given.offset, given.truth)
    return {name.removesuffix(".csv"): data.decode() for name, data in made.items()}


def without_names(text: str) -> str:
    """contacts.csv without its column of landmarks."""
    lines = [line.split(",") for line in text.splitlines()]
    place = lines[0].index("landmark")
    return "".join(",".join(cells[:place] + cells[place + 1 :]) + "\n" for cells in lines)


def written(path: Path) -> Path:
    """The folder of the mission without names."""
    return folder(path, files(), contacts=without_names(files()["contacts"]))


def test_it_is_read_without_its_contacts_which_are_counted(tmp_path: Path) -> None:
    path = written(tmp_path / "m")
    graph, values, report = nls.load(path)
    assert list(values.stacks) == ["x"]
    assert not any(isinstance(factor, RangeAzimuth | Elevation | ElevationHinge) for factor in graph.factors)
    assert len(report.sources) == len(graph.factors)
    count = len(files()["contacts"].splitlines()) - 1
    assert report.counts == {"contacts_without_names": count}
    assert f"none of its {count} contacts is in the graph" in report.notes[-1]
    assert "l" not in report.truth.stacks


@pytest.mark.usefixtures("undrawn")
def test_no_reading_command_solves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    unnamed, named = written(tmp_path / "m"), folder(tmp_path / "named")
    scans = room_files.write(tmp_path / "scans", room_files.room(1))
    (tmp_path / "plane.g2o").write_text(PLANE)

    def optimize(*_: object, **__: object) -> None:
        raise AssertionError("a reader solves")

    monkeypatch.setattr(FactorGraph, "optimize", optimize)
    for file in map(str, (unnamed, named, scans, tmp_path / "plane.g2o")):
        nls.load(file)
        assert main(["info", file]) == 0
        assert main(["plot", file, str(tmp_path / "out.png")]) == 0
        assert main(["convert", file, str(tmp_path / "out.npz")]) == 0
        out, err = capsys.readouterr()
        assert err == ""
        assert out.count("contacts.csv names no landmarks: none of its") == 3 * (file == str(unnamed))
    for command in ("solve", "explain"):
        with pytest.raises(AssertionError, match="a reader solves"):
            main([command, str(unnamed), "--debug"])


def test_every_factor_that_association_adds_knows_its_line(tmp_path: Path) -> None:
    path = written(tmp_path / "m")
    lines = (path / "contacts.csv").read_text().splitlines()
    lines.insert(1, "0,1.05,0.0,0.01,0.004")  # is of no landmark, so that rows and measurements are not the same
    read = nls.load(folder(path, {}, contacts="\n".join(lines)), elevation="prior")
    graph, values, report = associated(*read)
    assert (len(read[0].factors), list(read[1].stacks), len(read[2].notes)) == (4, ["x"], 1)  # as they were
    assert (report.unnamed, report.counts) == (None, {})
    assert associated(graph, values, report) == (graph, values, report)
    assert len(report.sources) == len(graph.factors) == 6
    (k,) = (k for k, factor in enumerate(graph.factors) if isinstance(factor, RangeAzimuth))
    contacts, names = graph.factors[k], lines[0].split(",")
    for row in (0, 7, len(contacts) - 1):
        file, number = report.place(k, row).rsplit(":", 1)
        cells = dict(zip(names, lines[int(number) - 1].split(","), strict=True))
        assert file == str(path / "contacts.csv")
        assert int(cells["i"]) == contacts.keys[0].numbers[row]
        assert [float(cells["range_m"]), float(cells["azimuth_rad"])] == contacts.z[row].tolist()
    (j,) = (j for j, factor in enumerate(graph.factors) if type(factor) is Elevation)
    for row in (0, len(graph.factors[j]) - 1):
        number = int(report.place(j, row).rsplit(":", 1)[1])
        assert int(lines[number - 1].split(",")[0]) == graph.factors[j].keys[0].numbers[row]
    true = [-1] + [int(line.split(",")[1]) for line in files()["contacts"].splitlines()[1:]]
    numbers = np.full(len(true), -1)
    rows = [int(report.place(k, row).rsplit(":", 1)[1]) - 2 for row in range(len(contacts))]
    numbers[rows] = contacts.keys[1].numbers
    assert min(pair_precision_recall(numbers, true)) > 0.9
    assert values.stack("l").numbers.tolist() == list(range(len(values.stack("l"))))
    result = graph.optimize(values)
    assert result.converged
    assert mission().ate(result.values) < mission().ate(mission().start)


@pytest.mark.usefixtures("undrawn")
def test_what_convert_advises_writes_the_graph_that_was_solved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "a dive")
    assert main(["convert", str(path), str(tmp_path / "read.npz")]) == 0
    advised = re.search(r"nls (solve .* --write-graph FILE) finds", capsys.readouterr().out)
    assert advised
    file = str(tmp_path / "solved.json")
    words = [file if word == "FILE" else word for word in shlex.split(advised[1])]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "sightings are of" in out
    assert f"written     {file}" in out
    graph, values, _ = nls.load(file)
    again = graph.optimize(values)
    np.testing.assert_allclose(again.values[x], values[x], atol=1e-6)
    solved = np.loadtxt(tmp_path / "out/map.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2, 3))
    np.testing.assert_array_equal(solved[:, 1:], values[l[solved[:, 0].astype(int)]])
    assert len(solved) > 20
    assert list(nls.load(tmp_path / "read.npz")[1].stacks) == ["x"]


def test_a_graph_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("nls.io.graph_files._read", None)
    (tmp_path / "plane.g2o").write_text(PLANE)
    path, file = str(written(tmp_path / "m")), str(tmp_path / "plane.g2o")
    for words, problem in (
        ([path, "--write-graph", str(tmp_path / "out.g2o")], "a mission cannot be written as g2o"),
        ([path, "--write-graph", str(tmp_path / "out.xyz")], "--write-graph"),
        ([path, "--write-graph", str(tmp_path / "no/out.npz")], "--write-graph"),
        ([file, "--write-graph", str(tmp_path / "out.npz")], "-o writes another graph"),
    ):
        assert main(["solve", *words]) == 2
        assert problem in capsys.readouterr().err


def test_contacts_that_nothing_joins_leave_the_track(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two of one pose: no landmark has three."""
    rows = "".join(line + "\n" for line in without_names(TINY["contacts"]).splitlines()[:3])
    path = folder(tmp_path / "m", contacts=rows, landmarks=None)
    read = nls.load(path)
    graph, values, _ = associated(*read)
    assert (list(values.stacks), len(graph.factors)) == (["x"], len(read[0].factors))
    assert main(["solve", str(path)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "0 of 2 sightings are of 0 landmarks" in out


def test_dives_need_names(tmp_path: Path) -> None:
    first = folder(tmp_path / "first")
    second = folder(tmp_path / "second", contacts="# the second\n" + without_names(TINY["contacts"]))
    for dives in ([first, second], [second, first]):
        with pytest.raises(GraphFileError, match="landmark") as refusal:
            nls.load(dives)
        assert str(refusal.value).startswith(f"{second / 'contacts.csv'}:2: ")
    with pytest.raises(OptionError, match="elevation"):
        nls.load(second, elevation="guess")


def test_a_track_that_is_not_determined_is_said_with_the_file(tmp_path: Path) -> None:
    path = written(tmp_path / "m")
    text = files()["zpr"].splitlines(keepends=True)
    with pytest.warns(GraphWarning, match="1 poses have no row in"):
        read = nls.load(folder(path, {}, zpr="".join(text[:2] + text[3:])))
    with pytest.raises(GraphFileError, match=r"contacts\.csv: names no landmarks.*x1: z, roll, pitch.*not determined"):
        associated(*read)


PATH = "time_s,x_m,y_m,z_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_z_m,sigma_yaw_rad\n" + "".join(
    f"{t},{0.5 * t},0,5,0,0.01,0.01,0.01,0.01\n" for t in range(3)
)
ROWS = [(0, 11, 4.7), (1, 11, 4.3), (2, 11, 3.8)]  # a time and a pose, a landmark, m


def loaded(path: Path, pose: str, rows: list[tuple[float, int, float]]) -> tuple[FactorGraph, Values, LoadReport]:
    """The mission of a path with these contacts; their first column is `pose`."""
    contacts = f"{pose}landmark,range_m,azimuth_rad,sigma_range_m,sigma_azimuth_rad\n"
    contacts += "".join(f"{f'{when},' * bool(pose)}{k},{r},0.05,0.01,0.004\n" for when, k, r in rows)
    return nls.load(folder(path, {"path": PATH, "sonar": TINY["sonar"], "contacts": contacts}))


def test_times_of_poses_are_these_poses(tmp_path: Path) -> None:
    (by_time, X, _), (by_pose, _, _) = (loaded(tmp_path, pose, ROWS) for pose in ("time_s,", "i,"))
    assert list(map(repr, by_time.factors)) == list(map(repr, by_pose.factors))
    assert by_time.chi2(X) == by_pose.chi2(X) > 1


def test_a_contact_between_two_rows_gets_a_pose_and_one_outside_is_left_out(tmp_path: Path) -> None:
    graph, X, report = loaded(tmp_path, "time_s,", [(-5, 12, 4.0), *ROWS, (0.25, 11, 4.6)])
    assert report.vertex_times["x"].tolist() == [0, 0.25, 1, 2]
    k, contacts = next((k, f) for k, f in enumerate(graph.factors) if isinstance(f, RangeAzimuth))
    assert contacts.keys[0].numbers.tolist() == [0, 2, 3, 1]
    assert np.ravel(contacts.z[:, 0]).tolist() == [4.7, 4.3, 3.8, 4.6]
    assert [report.place(k, row).rsplit(":")[-1] for row in range(4)] == ["3", "4", "5", "6"]
    assert list(X.stack("l").numbers) == [11]
    words = "contacts.csv:2: the first row of 1 that are left out, of 5: not within the track, 0.0 to 2.0 s"
    assert words in str(report)


def test_a_time_or_a_pose(tmp_path: Path) -> None:
    with pytest.raises(GraphFileError, match="has neither; expected either time_s or i"):
        loaded(tmp_path, "", ROWS)
