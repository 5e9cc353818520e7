"""The table of formats: a row is all that a format needs."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest

import nls
from nls.cli import main
from nls.io import formats
from nls.io.dialects import TAGGED
from nls.io.formats import FORMATS, Format
from tests.nls.io.g2o_files import assert_refused, write
from tests.nls.io.io_files import BAL, FILES, PYFG

TOY = "toy\n1.0 0.0\n2.5 1.0\n"
PLACE = "tests.nls.io.toy_format:"
ROW = Format("toy", "heights", "toy", (".toy",), lambda data: "its first line" * data.startswith(b"toy\n"))


@pytest.fixture
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FORMATS, "toy", ROW._replace(reader=f"{PLACE}read_toy", writer=f"{PLACE}toy_text"))


@pytest.mark.usefixtures("_registered")
def test_a_format_is_a_row(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    graph, values, report = nls.load(write(tmp_path, TOY, "heights.txt"))
    assert (report.format, report.reason, graph.chi2(values)) == ("toy", "its first line", 0.25)
    with pytest.warns(nls.GraphWarning, match=r"a\.toy: a toy file holds no sigmas"):
        nls.save("a.toy", graph, values)
    assert Path("a.toy").read_text() == TOY
    for words in ("convert a.toy b.json", "convert b.json c.toy.gz", "convert c.toy.gz d --to toy"):
        assert main(words.split()) == 0
    assert "note        a toy file holds no sigmas" in capsys.readouterr().out
    assert Path("d").read_text() == TOY
    assert main(["info", "d", "--dialect", "toy"]) == 0
    assert "d: toy (as asked for), 1-D" in capsys.readouterr().out
    for words, said in (
        ("info d --drop-absent", "d is in the format toy, which has no vertices to give"),
        ("convert d e.xyz", ".csv, .ply, .toy, or --to FORMAT"),
        ("info d --dialect toys", "did you mean 'toy'?"),
    ):
        assert main(words.split()) == 2
        assert said in capsys.readouterr().err
    with pytest.raises(nls.OptionError, match=r"expected one of auto, .*, json, toy"):
        nls.load("d", dialect="no")
    assert_refused(1, "'toy' is no tag", nls.load, "d", dialect="g2o")


def test_an_option_that_means_nothing_to_a_format_is_refused(tmp_path: Path) -> None:
    """A repair of matrices that are no information, tags where there are none; a mission is a format, too."""
    native = {
        form: nls.io.rendered("graph", nls.FactorGraph(), nls.Values(), None, form)[0] for form in ("npz", "json")
    }
    files = dict(FILES.values()) | {"pyfg": PYFG, "bal": BAL} | native
    assert set(files) == set(nls.io.DIALECTS[1:])
    write(tmp_path, "pose,time\n", "odometry.csv")
    for option, value in (("repair_information", True), ("ignore_tags", ["EDGE_X"]), ("drop_absent", True)):
        refused = {"mission"} if option != "repair_information" else {"mission", "isam", "isam-covariance", "graph"}
        for name in refused | {name for name in files if option not in FORMATS[name].options}:
            path = write(tmp_path, files[name], "graph.txt") if name in files else tmp_path
            dialect: dict[str, Any] = {"dialect": name} if name in files else {}
            expected = rf"{option}: .* expected {re.escape(repr(type(value)()))}: .* format {name}, which has no"
            with pytest.raises(nls.OptionError, match=expected):
                nls.load(path, **dialect, **{option: value})


def test_nobody_asks_for_a_format_by_its_name() -> None:
    """But the table, and a file that writes two of them; g2o is the name of a convention, too."""
    names = {name for name, row in FORMATS.items() if not row.folder} - {"g2o"}
    own = {"formats.py", "trajectory.py", "native.py"}
    asked = []
    for path in (path for path in Path(nls.__file__).parent.rglob("*.py") if path.name not in own):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if any(f'"{name}"' in text for name in names) else ():
            constants = [node.left, *node.comparators] if isinstance(node, ast.Compare) else []
            asked += [(path.name, c.value) for c in constants if isinstance(c, ast.Constant) and c.value in names]
    assert asked == []


def test_the_table_says_what_the_records_say() -> None:
    for name, dialect in TAGGED.items():
        row = FORMATS[name]
        vertices = any(record.factor is None and record.slots for record in dialect.records)
        assert (row.tagged, row.values, row.numbered) == (True, vertices, not dialect.apart)
    assert {name for name, row in FORMATS.items() if row.tagged} == set(TAGGED)
    assert {row.entries for row in FORMATS.values()} == {"", "information", "covariance"}
    assert all(TAGGED[row.name].matrix == row.entries for row in FORMATS.values() if row.entries)
    named = [function for row in FORMATS.values() for function in (row.reader, row.writer) if function]
    assert all(callable(formats._named(function)) for function in named)
