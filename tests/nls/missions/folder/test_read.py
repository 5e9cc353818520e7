"""Mission folders: what a graph is made of them, what is said of it, and the page that shows one."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, ZPR, Elevation, ElevationHinge, Heading, Position, RangeAzimuth
from models import euler
from nls import GraphWarning, OptionError
from nls.cli import main
from nls.missions import elevations, read_mission, track_of
from nls.missions.files import MAP, TRAJECTORY
from nls.missions.folder.columns import COLUMNS, POSE
from tests.nls.io.formats_page import columns_of, files_of, section, shown_tables
from tests.nls.missions.folder.mission_files import TINY, folder, raw

x, l = nls.kinds("x", "l")


def of(graph: nls.FactorGraph, kind: type) -> list[nls.Keys | np.ndarray]:
    """Keys, measurements and sigmas of the one factor of a kind."""
    (factor,) = [f for f in graph.factors if type(f) is kind]
    return [*factor.keys, factor.z, factor.noise.sigmas]


def test_every_number_has_its_place(tmp_path: Path) -> None:
    graph, values, report = nls.load(folder(tmp_path / "m"))
    assert [type(f) for f in graph.factors] == [XYH, ZPR, Position, Heading, RangeAzimuth, ElevationHinge]
    i, j, z, sigmas = of(graph, XYH)
    assert (i, j) == (x[[0, 1, 2]], x[[1, 2, 3]])
    assert z[1].tolist() == [0.491, 0.0259, 0.0489]
    assert sigmas[1].tolist() == [0.02, 0.02, 0.005]
    i, z, sigmas = of(graph, ZPR)
    assert (i, z[2].tolist(), sigmas[2].tolist()) == (x[[0, 1, 2, 3]], [5.2461, 0.041, -0.0405], [0.01, 0.002, 0.002])
    i, k, z, sigmas = of(graph, RangeAzimuth)
    assert (i[[9]], k[[9]], z[9].tolist(), sigmas[9].tolist()) == (x[[3]], l[[12]], [3.9747, -0.1361], [0.01, 0.004])
    assert [each.tolist() for each in of(graph, Position)[1:]] == [[[0.0, 0.0]], [[0.001, 0.001]]]
    assert [each.tolist() for each in of(graph, Heading)[1:]] == [[[0.0]], [[0.0001]]]
    assert (report.sonar.name, report.sonar.beams, report.sonar.bins) == ("DIDSON, high frequency", 96, 512)
    assert (report.sonar.fan, report.sonar.aperture, report.sonar.window) == (0.5027, 0.2443, (1.0, 6.0))
    assert euler.from_se3(report.offset).round(12).tolist() == [0.0, -0.5236, 0.0, 0.3, 0.0, 0.1]
    assert euler.from_se3(report.truth[x[2]]).round(12).tolist() == [-0.04, 0.04, 0.1, 1.0, 0.08, 5.25]
    assert report.truth[l[14]].tolist() == [5.2, 0.9, 7.5]
    assert "contacts.csv             11" in str(report)
    assert values[x].shape == (4, 7)


def test_the_start_is_dead_reckoning_from_the_anchor(tmp_path: Path) -> None:
    _, values, _ = nls.load(folder(tmp_path / "m"))
    E = euler.from_se3(values[x])
    assert E[:, [5, 1, 0]] == pytest.approx(np.loadtxt(TINY["zpr"].splitlines()[1:], delimiter=",")[:, 1:4])
    steps = np.loadtxt(TINY["odometry"].splitlines()[1:], delimiter=",")[:, 2:5]
    yaw = np.append(0.0, np.cumsum(steps[:, 2]))
    assert E[:, 2] == pytest.approx(yaw, abs=1e-12)
    way = np.append(0.0, np.cumsum(np.exp(1j * yaw[:3]) * (steps[:, 0] + 1j * steps[:, 1])))
    assert E[:, 3:5] == pytest.approx(np.column_stack([way.real, way.imag]), abs=1e-12)

    anchor = TINY["anchor"].splitlines()[0] + "\n2,10.0,-3.0,1.2,0.001,0.001,0.0001\n"
    graph, other, _ = nls.load(folder(tmp_path / "other", anchor=anchor))
    moved = euler.from_se3(other[x])
    assert moved[2, [3, 4, 2]] == pytest.approx([10.0, -3.0, 1.2])
    assert moved[:, [0, 1, 5]] == pytest.approx(E[:, [0, 1, 5]], abs=1e-12)
    lengths = [np.linalg.norm(np.diff(each[:, 3:5], axis=0), axis=1) for each in (E, moved)]
    assert lengths[0] == pytest.approx(lengths[1])
    seen = elevations(graph, other)
    assert seen.elevation == pytest.approx(0.0, abs=1e-9)  # where they were seen first
    assert seen.range.tolist() == pytest.approx([4.7457, 5.239, 5.5399])
    assert (seen.poses.tolist(), seen.views.tolist()) == ([0, 0, 0], [3, 4, 4])


def test_a_landmark_moved_along_its_arc_changes_its_elevation_alone(tmp_path: Path) -> None:
    graph, values, _ = nls.load(folder(tmp_path / "m"))
    values = graph.optimize(values).values
    found = elevations(graph, values)
    values[l[found.landmarks]] = values[l[found.landmarks]] + 1e-4 * found.range[:, None] * found.along
    grown = elevations(graph, values)
    assert grown.elevation - found.elevation == pytest.approx(1e-4, rel=1e-3)
    assert grown.range == pytest.approx(found.range, abs=1e-7)


def test_options_of_a_folder_and_of_a_file(tmp_path: Path) -> None:
    here = folder(tmp_path / "m")
    for elevation, kinds in (("free", []), ("prior", [Elevation]), ("hinge", [ElevationHinge])):
        graph, _, _ = nls.load(here, elevation=elevation)
        assert [type(f) for f in graph.factors[5:]] == kinds
    with pytest.raises(OptionError, match="elevation: 'search' is not possible"):
        read_mission(here, "search")
    (tmp_path / "a.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    for place, option, problem in (
        (here, {"dialect": "g2o"}, r"dialect: 'g2o' is not possible; expected auto: .*m is a folder"),
        (here, {"repair_information": True}, r"repair_information: True .* format mission"),
        (tmp_path / "a.g2o", {"elevation": "free"}, r"elevation: 'free' .* no folder of a mission"),
    ):
        with pytest.raises(OptionError, match=problem):
            nls.load(place, **option)


def test_columns_in_any_order_blanks_comments_and_gzip(tmp_path: Path) -> None:
    one = nls.load(folder(tmp_path / "m"))
    files = {}
    for name, text in TINY.items():
        rows = [line.split('"') for line in text.splitlines()]
        # the quoted name has a comma
        cells = [r[0].split(",") if len(r) == 1 else [f'"{r[1]}"', *r[2].split(",")[1:]] for r in rows]
        order = np.random.default_rng(len(name)).permutation(len(cells[0]))
        lines = ["# a comment, with commas", "", *(" ,\t".join(row[k] for k in order) for row in cells)]
        files[name] = "\r\n".join(lines)
    other = folder(tmp_path / "other", files)
    (other / "zpr.csv").unlink()
    (other / "zpr.csv.gz").write_bytes(gzip.compress(b"\xef\xbb\xbf" + files["zpr"].encode()))
    two = nls.load(other)
    assert two[0].chi2(two[1]) == one[0].chi2(one[1])
    assert "7 comment lines" in two[2].notes
    (other / "zpr.csv").write_text(files["zpr"])
    with pytest.raises(nls.GraphFileError, match=r"zpr\.csv\.gz: there is zpr\.csv beside it"):
        nls.load(other)


def test_what_is_not_read_is_said(tmp_path: Path) -> None:
    here = folder(tmp_path / "m", contact=TINY["contacts"])
    (here / "notes.txt").write_text("a mission")
    with pytest.warns(GraphWarning, match=r"no file of a mission, not read: contact\.csv; expected names: sonar, cont"):
        report = nls.load(here)[2]
    assert "not read: notes.txt" in report.notes
    (here / "contact.csv").unlink()
    lines = TINY["contacts"].replace("0,11,4.7457,0.0625", "0,11,6.7457,0.0625") + "3,14,4.23,0.107,0.01,0.004\n"
    odometry = TINY["odometry"] + "0,1,0.53,-0.03,0.05,0.02,0.02,0.005\n"
    truth = "\n".join([*TINY["truth"].splitlines()[:-1], "9,0,0,0,0,0,0"])
    said = " ".join(nls.load(folder(here, contacts=lines, odometry=odometry, truth=truth))[2].notes)
    for note in (
        *("contacts.csv:2: a contact outside", "odometry.csv measures 1 steps more than once"),
        *("truth.csv has no row for 1 of 4 poses", "truth.csv has 1 poses nothing measures"),
    ):
        assert note in said
    with pytest.warns(GraphWarning, match="1 poses have no row in zpr.csv, the first is 3"):
        nls.load(folder(here, zpr="\n".join(TINY["zpr"].splitlines()[:-1])))


def test_without_an_anchor_and_times_of_poses(tmp_path: Path) -> None:
    here = folder(tmp_path / "times", poses="i,time_s\n2,0.5\n0,1.5\n3,2.5\n1,4.0\n")
    assert nls.load(here)[2].vertex_times["x"].tolist() == [1.5, 4.0, 0.5, 2.5]
    truth = TINY["truth"].replace("0,0.0,0.0,0.0,0.0,0.0,5.0", "0,0.0,0.0,0.5,7.0,8.0,5.0")
    _, values, report = nls.load(folder(tmp_path / "m", anchor=None, truth=truth))
    assert euler.from_se3(values[x[0]])[[3, 4, 2]] == pytest.approx([7.0, 8.0, 0.5])
    assert "there is no anchor.csv: x, y and yaw of x0 are fixed at the truth" in report.notes
    _, values, report = nls.load(folder(tmp_path / "n", anchor=None, truth=None))
    assert "there is no anchor.csv: x, y and yaw of x0 are fixed at 0" in report.notes
    assert euler.from_se3(values[x[0]])[[3, 4, 2]] == pytest.approx([0.0, 0.0, 0.0])


def test_a_track_on_the_earth_whose_heading_nothing_measured_is_a_warning(tmp_path: Path) -> None:
    origin = "lat_deg,lon_deg\n54.0,10.0\n"
    here = folder(tmp_path / "m", anchor=None, truth=None, origin=origin)
    with pytest.warns(GraphWarning, match="the position of x0 on the Earth and its heading are unknown; write both"):
        nls.load(here)
    _, _, report = nls.load(folder(tmp_path / "n", truth=None, origin=origin))  # the cure
    assert not report.warnings
    assert not nls.load(folder(tmp_path / "log", raw() | {"origin": origin}))[2].warnings  # its heading was measured


def test_a_raw_log_is_integrated(tmp_path: Path) -> None:
    graph, values, report = nls.load(folder(tmp_path / "m", raw()))
    assert [type(f) for f in graph.factors] == [XYH, ZPR, Heading, Position]
    E = euler.from_se3(values[x])
    t = np.arange(31.0)
    gone = np.minimum(t, 20.0) + 0.125 * (t > 20)  # the velocity falls to 0 within a sample after 20 s
    assert E[:, 3:5] == pytest.approx(np.outer(gone, [np.cos(0.3), np.sin(0.3)]), abs=1e-3)
    assert E[:, 5] == pytest.approx(2 + 0.1 * t)
    assert E[:, 2] == pytest.approx(np.where(t <= 20, 0.3, 0.3 + 0.05 * (t - 20)))
    assert report.vertex_times["x"].tolist() == t.tolist()
    assert graph.chi2(values) < 1e-15
    assert "there is no anchor.csv: x and y of x0 are fixed at 0" in report.notes

    poses = "i,time_s\n" + "".join(f"{7 * k},{float(s)!r}\n" for k, s in enumerate([0.0, 3.3, 19.0, 21.7]))
    mount = "x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad\n0.0,0.0,0.0,0.0,0.0,0.3\n"
    files = raw(lost=(5.0, 8.0)) | {"poses": poses, "dvl_mount": mount}
    turned, values, report = nls.load(folder(tmp_path / "turned", files))
    assert values.stack("x").numbers.tolist() == [0, 7, 14, 21]
    E = euler.from_se3(values[x])
    assert E[:3, 3:5] == pytest.approx(np.outer([0.0, 3.3, 19.0], [np.cos(0.6), np.sin(0.6)]), abs=1e-9)
    assert any("bridged for 3 s" in note for note in report.notes)
    W = turned.factors[0].noise.matrix
    assert 2 * W[1, 0, 0] < W[0, 0, 0]  # the leg with the gap


def test_poses_that_are_not_numbered_in_the_order_of_time(tmp_path: Path) -> None:
    files = raw() | {"poses": "i,time_s\n21,0.0\n7,3.3\n14,19.0\n"}
    _, values, report = nls.load(folder(tmp_path / "m", files))
    assert values.stack("x").numbers.tolist() == [7, 14, 21]
    assert report.vertex_times["x"].tolist() == [3.3, 19.0, 0.0]
    along = euler.from_se3(values[x])[:, 3:5] @ [np.cos(0.3), np.sin(0.3)]
    assert along - along[2] == pytest.approx([3.3, 19.0, 0.0])
    track = track_of(values, values, report, "solution")
    assert track.numbers.tolist() == [21, 7, 14]
    assert track.along == pytest.approx(np.hypot([0.0, 3.3, 19.0], 0.1 * np.array([0.0, 3.3, 19.0])))


def test_a_track_in_pieces_and_landmarks_that_nothing_judges(tmp_path: Path) -> None:
    lost = "\n".join(row for row in TINY["odometry"].splitlines() if not row.startswith("1,"))
    with pytest.warns(GraphWarning, match=r"odometry\.csv leaves the track in 2 pieces, the second begins at pose 2: "):
        assert nls.load(folder(tmp_path / "lost", odometry=lost))[1][x].shape == (4, 7)
    head, one, two, three = TINY["landmarks"].splitlines()

    unseen = {"contacts": None, "sonar": None}
    for k, (given, files, words) in enumerate(
        (
            ([one, two, three], {}, ""),
            ([two], {}, "no row for 2 of 3 landmarks"),
            ([one, two, three, "99,1,2,3"], {}, "has 1 landmarks nothing measures"),
            (["7,1,2,3", "8,1,2,3"], {}, "not used: none of its landmarks, 7 the first, is in contacts.csv, where 11"),
            ([one], unseen, "is not used: there is no contacts.csv"),
        )
    ):
        report = nls.load(folder(tmp_path / str(k), landmarks="\n".join([head, *given]), **files))[2]
        said = [note for note in report.notes if note.startswith("landmarks.csv")]
        assert len(said) == bool(words)
        assert words in "".join(said)


def test_a_truth_of_times_is_interpolated_to_the_poses(tmp_path: Path) -> None:
    """The vehicle goes 1 m/s; its yaw crosses pi between two rows; the truth ends before the track."""
    truth = "time_s,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n-1.5,0,0,3.0,-1.5,0,2\n4.5,0,0,-3.0,4.5,6,5\n"
    _, values, report = nls.load(folder(tmp_path / "m", raw(), truth=truth))
    assert euler.from_se3(values[x[0]])[[3, 4, 2]] == pytest.approx([0.0, 1.5, 0.3])  # the heading is the compass's
    first, last = euler.from_se3(report.truth[x[[0, 4]]])
    turn = (2 * np.pi - 6.0) / 6.0  # rad/s, the short way
    assert first == pytest.approx([0, 0, 3.0 + 1.5 * turn, 0.0, 1.5, 2.75])
    assert last == pytest.approx([0, 0, 3.0 + 5.5 * turn - 2 * np.pi, 4.0, 5.5, 4.75])
    assert len(report.truth.stack("x")) == 5
    assert any("errors are of 5 poses, not of 26 before or after it" in note for note in report.notes)


def test_headings_of_a_compass_beside_odometry(tmp_path: Path) -> None:
    """Of the world, so that only x and y of a pose are held where there is no anchor."""
    head, *rows = TINY["zpr"].splitlines()
    yaws = [0.5, 0.55, 0.6, 0.6 - 2 * np.pi]
    lines = [f"{head},yaw_rad,sigma_yaw_rad", *(f"{row},{yaw},0.01" for row, yaw in zip(rows, yaws, strict=True))]
    zpr = "\n".join(lines)
    graph, start, report = nls.load(folder(tmp_path / "m", zpr=zpr, anchor=None))
    (compass,) = [factor for factor in graph.factors if isinstance(factor, Heading)]
    np.testing.assert_allclose(compass.z[:, 0], [0.5, 0.55, 0.6, 0.6])
    assert report.place(graph.factors.index(compass), 2).endswith("zpr.csv:4")
    assert any("x and y of x0 are fixed" in note for note in report.notes)
    values = graph.optimize(start).values
    np.testing.assert_allclose(euler.from_se3(values[x])[:, 2], [0.5, 0.55, 0.6, 0.6], atol=0.01)
    with pytest.raises(nls.GraphFileError, match="has yaw_rad and no sigma_yaw_rad"):
        nls.load(folder(tmp_path / "n", zpr="\n".join(line.rpartition(",")[0] for line in lines)))


TITLE = "Mission folders"


@pytest.mark.usefixtures("undrawn")
def test_the_folder_it_shows_is_solved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = shown_tables(section(TITLE))
    assert shown == TINY
    assert main(["solve", str(folder(tmp_path / "m", shown)), "-o", str(tmp_path / "out")]) == 0
    outputs, more = section(TITLE).split("it writes into")[1].split("Where the mission says more")
    assert {path.name for path in (tmp_path / "out").iterdir()} == files_of(outputs)
    assert "converged" in capsys.readouterr().out

    charted = folder(tmp_path / "charted", shown | {"origin": "lat_deg,lon_deg\n54.1,10.2\n"})
    assert main(["solve", str(charted), "-o", str(tmp_path / "chart")]) == 0
    added = {path.name for path in (tmp_path / "chart").iterdir()} - files_of(outputs)
    assert added == files_of(more) - {"beacons.csv", "calibration.csv"} == {"track.geojson", "track.kml"}


def test_every_file_and_column_is_defined_and_no_other() -> None:
    columns = columns_of(section(TITLE).split("A whole mission")[0])
    assert columns == {name: list(names) for name, names in COLUMNS.items()}


def test_the_columns_of_the_outputs() -> None:
    text = section(TITLE).split("it writes into")[1]
    assert TRAJECTORY[0] == "i"
    assert TRAJECTORY[:7] == POSE
    assert (TRAJECTORY[7], TRAJECTORY[-1]) == ("sigma_roll_rad", "sigma_z_m")
    for name in (*TRAJECTORY[7::5], *MAP[:5], *MAP[9:]):
        assert f"`{name}`" in text, name
