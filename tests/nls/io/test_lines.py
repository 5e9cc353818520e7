"""The line of every measurement: in the report of each format, with anything between the measurements."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np

import nls
from factors import XYH, ZPR, Elevation, ElevationHinge, Heading, Position, RangeAzimuth
from factors.base import Factor
from tests.combinations import for_all
from tests.nls.io.io_files import ALL
from tests.nls.io.test_pyfg import PLANE
from tests.nls.missions.folder.mission_files import TINY, folder, raw

NO_MEASUREMENT = ("VERTEX", "PARAMS", "FIX", "#", "EDGE_SWITCH_PRIOR")
TEXTS = ALL | {"pyfg, two vehicles": ("pyfg", PLANE)}
ENDS = ["\n", "\r\n", "\r"]


def shuffled(text: str, dialect: str) -> list[str]:
    """The lines in another order, so that tags alternate, with comments and blank lines between; bal has an order."""
    rng = np.random.default_rng(5)
    lines = text.splitlines()
    if dialect == "bal":
        return [lines[0], "", *lines[1:2], "  ", *lines[2:]]
    between = ["", "# EDGE_SE2 0 1 is a comment", " \t"]
    rest = [[*rng.choice(between, rng.integers(0, 4)), line] for line in rng.permutation(lines)]
    return [str(line) for some in rest for line in some]


def variables(factor: Factor, k: int, dialect: str) -> list[str]:
    """The variables of a measurement as its line names them."""
    keys = [(keys.kind, int(keys.numbers[k])) for keys in factor.keys]
    if dialect == "bal":
        (_, camera), (_, lens), (_, point) = keys
        assert camera == lens
        return [str(camera), str(point)]
    return [f"{kind}{number}" if dialect == "pyfg" else str(number) for kind, number in keys]


@for_all(name=TEXTS)
def test_the_line_is_that_of_the_measurement(name: str, tmp_path: Path) -> None:
    dialect, text = TEXTS[name]
    lines = shuffled(text, dialect)
    path = tmp_path / "graph.txt.gz"
    path.write_bytes(gzip.compress(ENDS[len(name) % 3].join(lines).encode()))
    graph, _, report = nls.load(path, dialect=dialect)
    assert len(report.sources) == len(graph.factors)
    begin = {"bal": 0, "pyfg": 2}.get(dialect, 1)  # words in front of the variables
    for number, (factor, source) in enumerate(zip(graph.factors, report.sources, strict=True)):
        assert source.lines.dtype == np.intp
        assert source.lines.shape == (len(factor),)
        for k, line in enumerate(source.lines.tolist()):
            words, names = lines[line - 1].split(), variables(factor, k, dialect)
            assert words[begin : begin + len(names)] == names
            assert float(np.ravel(factor.z[k])[0]) in map(float, words[begin + len(names) :])
            assert report.place(number, k) == f"{path}:{line}"
    measured = [k + 1 for k, line in enumerate(lines) if line.strip() and not line.startswith(NO_MEASUREMENT)]
    measured = measured[1:3] if dialect == "bal" else measured
    measured += [k + 1 for k, line in enumerate(lines) if ":PRIOR" in line]
    assert sorted(np.concatenate([source.lines for source in report.sources])) == sorted(measured)


@for_all(elevation=["hinge", "prior", "free"])
def test_a_mission_names_table_and_row(elevation: str, tmp_path: Path) -> None:
    header, *contacts = TINY["contacts"].splitlines()
    mixed = "\n".join(["# seen", header, "", *contacts[::-1], "# the end"])  # first contacts stand last
    path = folder(tmp_path / "m", contacts=mixed)
    graph, _, report = nls.load(path, elevation=elevation)
    tables = dict.fromkeys([RangeAzimuth, ElevationHinge, Elevation], "contacts") | {XYH: "odometry", ZPR: "zpr"}
    for number, factor in enumerate(graph.factors):
        table = path / f"{tables.get(type(factor), 'anchor')}.csv"
        lines = table.read_text().splitlines()
        assert len(report.sources[number].lines) == len(factor)
        for k in range(len(factor)):
            file, line = report.place(number, k).rsplit(":", 1)
            assert file == str(table)
            row = lines[int(line) - 1].split(",")
            assert row[: len(factor.keys)] == [str(keys.numbers[k]) for keys in factor.keys]
    assert len(graph.factors) == len(report.sources)


def test_a_raw_log_names_the_rows_before_its_poses(tmp_path: Path) -> None:
    files = raw() | {"poses": "i,time_s\n" + "".join(f"{k},{k + 0.25 * (k % 3) + 0.1}\n" for k in range(20))}
    files["ahrs"] = "\n".join(row for row in files["ahrs"].splitlines() if not row.startswith(("8.", "9.")))
    path = folder(tmp_path / "m", files)
    graph, _, report = nls.load(path)
    times = report.vertex_times["x"]
    assert [(type(f), len(f)) for f in graph.factors] == [(XYH, 19), (ZPR, 20), (Heading, 18), (Position, 1)]
    for number, name in enumerate(("dvl", "depth", "ahrs")):
        factor, source = graph.factors[number], report.sources[number]
        t = np.loadtxt(path / f"{name}.csv", delimiter=",", skiprows=1)[:, 0]
        rows, at = source.lines - 2, times[factor.keys[0].numbers]
        assert source.path == str(path / f"{name}.csv")
        assert (t[rows] <= at).all()
        assert (at < t[rows + 1]).all()
    assert len(report.sources) == len(graph.factors)
    assert report.place(0, 3) == f"{path / 'dvl.csv'}:14"  # 3.0 s; the pose is at 3.1 s
    assert report.place(3, 0) == str(path)
