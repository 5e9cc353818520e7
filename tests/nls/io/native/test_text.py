"""The text of a native file: what a parser would lose is refused, and a fault is named where it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import nls
from factors import Isotropic, Prior
from models import R
from nls import FactorGraph, GraphFileError, Values, kinds

x, l = kinds("x", "l")
HEAD = '{"format": "leadline graph",\n'


def text_of(folder: Path) -> str:
    """A graph of three priors on two variables."""
    graph = FactorGraph([Prior(l[[0, 1]], [[0.0, 1.0]], Isotropic(1.0)), Prior(x[0], [10.0], Isotropic(1.0))])
    nls.save(folder / "good.json", graph, Values({x: (R(1), [[0.0]]), l: (R(2), [[0.0, 0.0], [1.0, 1.0]])}))
    return (folder / "good.json").read_text()


@pytest.mark.parametrize("repeated", ["factors", "x", "l", "0", "1", "numbers", "X", "noise", "sigma", "type"])
def test_a_key_that_is_given_twice_is_named_with_its_line(repeated: str, tmp_path: Path) -> None:
    """The last such key of the file comes again, above itself, as quotes and braces in other texts do not disturb."""
    text = text_of(tmp_path)
    assert nls.load(tmp_path / "good.json")[0].chi2(nls.load(tmp_path / "good.json")[1]) > 0
    before, key, behind = text.rpartition(f'"{repeated}": ')
    twice = f'{before}{key}{{"\\"{repeated}\\": {{": [], "b": "{repeated}"}},\n\n{key}{behind}'
    assert json.loads(twice) == json.loads(text)  # it is lost without a word
    (tmp_path / "twice.json").write_text(twice)
    line = before.count("\n") + 3
    with pytest.raises(GraphFileError, match=rf"^\S+twice.json:{line}: the key '{repeated}' is given twice"):
        nls.load(tmp_path / "twice.json")


@pytest.mark.parametrize(
    ("rest", "line"),
    [
        (' "version": 1 \n\n\n\n', 2),
        (' "version": 1 \n\n\n\n "values": {}}', 2),
        (' "version": 1,\n\n\n ', 2),
        (' "version":\n\n\n\n }', 2),
        (' "version": [1, 2\n\n\n', 2),
        (' "version":\n\n 1,\n x: 3', 5),
        (' "version":\n\n one}', 4),
        (' "version": "1\n\n"}', 2),
    ],
)
def test_a_fault_is_named_where_it_is_not_where_it_is_noticed(rest: str, line: int, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(HEAD + rest)
    with pytest.raises(GraphFileError, match=rf"a\.json:{line}: is no JSON"):
        nls.load(tmp_path / "a.json")
