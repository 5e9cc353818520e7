"""Missions whose contacts name no landmarks: read, solved, and refused where names are needed."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import Elevation, ElevationHinge, RangeAzimuth
from models.errors import GraphFileError, OptionError
from nls import kinds
from nls.cli import main
from nls.filters.association import pair_precision_recall
from nls.missions.folder.write import mission_files
from tests.nls.missions.folder.mission_files import TINY, folder

x, l = kinds("x", "l")


@cache
def mission() -> sim.Mission:
    """One leg over the sea floor, there and back."""
    return sim.hauv_floor(np.random.default_rng(1), legs=1, per_leg=8)


def names_of() -> str:
    """contacts.csv as it is with names."""
    given = mission()
    return mission_files(given.graph, given.sonar, given.offset)["contacts.csv"].decode()


def without_names(text: str) -> str:
    """contacts.csv without its column of landmarks."""
    lines = [line.split(",") for line in text.splitlines()]
    place = lines[0].index("landmark")
    return "".join(",".join(cells[:place] + cells[place + 1 :]) + "\n" for cells in lines)


def written(path: Path) -> Path:
    """The folder of the mission without names."""
    path.mkdir()
    given = mission()
    for name, data in mission_files(given.graph, given.sonar, given.offset, given.truth).items():
        (path / name).write_bytes(without_names(data.decode()).encode() if name == "contacts.csv" else data)
    return path


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not rendered."""
    monkeypatch.setattr("nls.plot.picture.drawn", lambda path, figure: b"drawn")


def test_it_is_read_and_every_factor_knows_its_line(tmp_path: Path) -> None:
    given, path = mission(), written(tmp_path / "m")
    head, rest = (path / "contacts.csv").read_text().split("\n", 1)
    false = "0,1.05,0.0,0.01,0.004"  # is of no landmark, so that rows and measurements are not the same
    (path / "contacts.csv").write_text("\n".join([head, false, rest]))
    graph, values, report = nls.load(path, elevation="prior")
    assert len(report.sources) == len(graph.factors)
    (k,) = (k for k, factor in enumerate(graph.factors) if isinstance(factor, RangeAzimuth))
    contacts = graph.factors[k]
    lines = (path / "contacts.csv").read_text().splitlines()
    names = lines[0].split(",")
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
    true = [-1] + [int(line.split(",")[1]) for line in names_of().splitlines()[1:]]
    numbers = np.full(len(true), -1)
    numbers[[int(report.place(k, row).rsplit(":", 1)[1]) - 2 for row in range(len(contacts))]] = contacts.keys[
        1
    ].numbers
    assert min(pair_precision_recall(numbers, true)) > 0.9
    assert "l" not in report.truth.stacks
    assert values.stack("l").numbers.tolist() == list(range(len(values.stack("l"))))
    result = graph.optimize(values)
    assert result.converged
    assert given.ate(result.values) < given.ate(given.start)


def test_the_command_line_solves_it(tmp_path: Path, capsys: pytest.CaptureFixture[str], undrawn: None) -> None:
    path = written(tmp_path / "m")
    assert main(["solve", str(path), "-o", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "names no landmarks" in out
    assert len((tmp_path / "out/map.csv").read_text().splitlines()) > 20


def test_contacts_that_nothing_joins_leave_the_track(
    tmp_path: Path, undrawn: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two of one pose: no landmark has three."""
    rows = "".join(line + "\n" for line in without_names(TINY["contacts"]).splitlines()[:3])
    graph, values, report = nls.load(folder(tmp_path / "m", contacts=rows, landmarks=None))
    assert list(values.stacks) == ["x"]
    assert sum(len(factor) for factor in graph.factors if isinstance(factor, RangeAzimuth | ElevationHinge)) == 0
    assert len(report.sources) == len(graph.factors)
    assert graph.optimize(values).converged
    assert main(["solve", str(tmp_path / "m"), "-o", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(["info", str(tmp_path / "m")]) == 0
    assert "2 contacts without names" in capsys.readouterr().err


def test_dives_need_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = folder(tmp_path / "first")
    second = folder(tmp_path / "second", contacts="# the second\n" + without_names(TINY["contacts"]))
    for dives in ([first, second], [second, first]):
        with pytest.raises(GraphFileError, match="landmark") as refusal:
            nls.load(dives)
        assert str(refusal.value).startswith(f"{second / 'contacts.csv'}:2: ")
    assert main(["solve", str(first), str(second)]) == 2
    assert f"{second / 'contacts.csv'}:2: " in capsys.readouterr().err
    with pytest.raises(OptionError, match="elevation"):
        nls.load(second, elevation="guess")


def test_a_track_that_is_not_determined_is_said_with_the_file(tmp_path: Path) -> None:
    path = written(tmp_path / "m")
    text = (path / "zpr.csv").read_text().splitlines(keepends=True)
    (path / "zpr.csv").write_text("".join(text[:2] + text[3:]))
    with pytest.raises(GraphFileError, match=r"contacts\.csv: names no landmarks.*x1: z, roll, pitch.*not determined"):
        nls.load(path)
