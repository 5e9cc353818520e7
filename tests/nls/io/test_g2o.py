"""g2o files: read, written and read again the same to the bit; whatever is wrong in one has its line."""

from __future__ import annotations

import warnings
from cProfile import Profile
from pathlib import Path

import numpy as np
import pytest

from factors import Information
from nls import GraphFileError, GraphWarning, OptionError, kinds, load
from nls.io.read import read_graph
from nls.plot.trajectory import closures
from tests.combinations import for_all
from tests.nls.io import g2o_files
from tests.nls.io.g2o_files import CONVENTIONS, INFORMATION_2, PLANE, SPACE, UPPER_3, again, cases, read, same, write

x, l = kinds("x", "l")


def test_round_trip_with_everything_unusual(tmp_path: Path) -> None:
    text = f"""# a comment
EDGE_SE2 900 -4 0.1 -0.0 1e-320 1e300 0 0 1e-300 0 5e-324

VERTEX_SE2 900 .5 5. 3.1415926535897931
FIX 7
VERTEX_SE2 {2**63 - 1} 1e22 -1e-7 -12.5
VERTEX_SE2 -4 0.1 0.2 0.30000000000000004
PARAMS_SE2OFFSET 0 0 0 0
VERTEX_SE2 7 1 2 3
EDGE_SE2 7 {2**63 - 1} 1 2 3 1 0 0 1 0 0
EDGE_WHATEVER ünïcode 1 2   three
FIX 900 -4
# another
"""
    with pytest.warns(
        GraphWarning, match=r"unknown tags were not used: EDGE_WHATEVER \(1, first on line 11\)"
    ) as caught:
        loaded = load(write(tmp_path, text), ignore_tags=["EDGE_WHATEVER"])
    assert [Path(w.filename).name for w in caught] == ["test_g2o.py"]  # it points at the line that called load
    graph, values, report = loaded
    assert values.stacks["x"].numbers.tolist() == [900, 2**63 - 1, -4, 7]
    assert graph.factors[0].keys[0].numbers.tolist() == [900, 7]
    assert sorted(n for keys in graph.fixed for n in keys.numbers.tolist()) == [-4, 7, 900]
    assert report.ignored == ["EDGE_WHATEVER ünïcode 1 2   three", "PARAMS_SE2OFFSET 0 0 0 0"]
    assert "1 parameter that no edge uses" in report.notes
    assert report.tags == {"EDGE_SE2": 2, "VERTEX_SE2": 4, "FIX": 2, "PARAMS_SE2OFFSET": 1, "EDGE_WHATEVER": 1}
    assert "2 comment lines" in report.notes
    same(loaded, again(loaded, tmp_path, ignore_tags=["EDGE_WHATEVER"]))
    lines = (tmp_path / "again.g2o").read_text().splitlines()
    assert lines[0] == "VERTEX_SE2 900 0.5 5 3.141592653589793"
    assert lines[1] == "FIX 900"
    assert "#" not in "".join(lines)
    assert lines[-2:] == report.ignored


# ---- what is wrong has its line

V2, V3 = "VERTEX_SE2", "VERTEX_SE3:QUAT"
E2 = f"EDGE_SE2 0 1 1 0 0 {INFORMATION_2}"
TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
Q = "0 0 0 0 0 0 1"

two = TWO.strip().replace("\n", "\\n")

# file, line, words of the error
WRONG = cases(rf"""
 | 1 | is empty; expected lines such as EDGE_SE2
FIX 0\n | 1 | neither a vertex nor an edge
\n# hi\n#ho\n | 2 | nothing but comments
FIX 0\nhello\n | 2 | 'hello' is no tag
\nVERTEX_SE2 0 0 0\n | 2 | 3 numbers after the tag, expected 4: id x y theta
{two}\n{E2} 100\n | 3 | 12 numbers after the tag, expected 11: i j dx dy dtheta
{two}\n{E2} 7\n{E2}\n | 3 | 12 numbers after the tag, expected 11
{two}\nEDGE_SE2\n | 3 | 0 numbers after the tag
VERTEX_SE2 1 0 0 0\nVERTEX_SE2 0.5 0 0 0\n | 2 | id '0.5'
{two}\nVERTEX_SE2 0 5 5 5\n{E2} | 3 | vertex 0 was given before, on line 1
{two}\n{E2}\nEDGE_SE2 1 1 1 0 0 {INFORMATION_2}\n | 4 | vertex 1 to itself
{two}\n{E2}\nEDGE_SE2 1 9 1 0 0 {INFORMATION_2}\n | 4 | vertex 9, which no VERTEX_SE2 line has
{two}\nVERTEX_SWITCH 5 1\nFIX 5\n | 4 | no VERTEX_SE2 line has
{two}\nVERTEX_SWITCH 5 1\nEDGE_SE2 0 5 1 0 0 {INFORMATION_2}\n | 4 | no VERTEX_SE2 line has
{two}\n{E2}\nEDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n | 4 | eigenvalue -1
{two}\nEDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\nEDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n | 3 | negative eigenvalue
{V3} 0 {Q}\n{V3} 1 0 0 0 0 0 0 2\n | 2 | length 2, expected 1; the order is x y z w
{two}\n{E2}\n{V3} 2 {Q}\n | 4 | plane and of space
{V3} 2 {Q}\n{two}\n | 2 | plane and of space
{E2}\nFIX 1\nFIX 0 7\n | 3 | vertex 7, which no EDGE_SE2 line has
{two}\n{E2}\nFIX one\n | 4 | id 'one'
{two}\n{E2}\nFIX\n | 4 | expected FIX id
EDGE_SE2 0 1 1e308 0 0 {INFORMATION_2}\nEDGE_SE2 1 2 1e308 0 0 {INFORMATION_2}\n | 1 | beyond the largest number
""")


@for_all(case=WRONG)
def test_every_mistake_has_its_line(case: list[str]) -> None:
    line = int(case[1])
    assert str(g2o_files.assert_refused(line, case[2], read, case[0])).startswith(f"f.g2o:{line}: ")


# ---- what is unusual and right


def test_vertices_alone_and_a_wrong_convention() -> None:
    with pytest.raises(OptionError, match="convention: 'g3o'"):
        read(PLANE, "g3o")
    assert len(read(TWO)[0]) == 0


def test_zero_information_is_legal(tmp_path: Path) -> None:
    loaded = read(TWO + E2 + "\nEDGE_SE2 0 1 5 5 5 0 0 0 0 0 0\nEDGE_SE2 0 1 1.5 0 0 4 0 0 0 0 0\n")
    same(loaded, again(loaded, tmp_path))


# ---- conventions


def information(convention: str, text: str = SPACE) -> np.ndarray:
    noise = read(text, convention)[0].factors[0].noise
    assert isinstance(noise, Information)
    return noise.matrix


def test_the_upper_triangle_row_by_row_and_only_log_converts_and_only_in_space() -> None:
    assert information("g2o", PLANE)[0].tolist() == [[500, 1, 2], [1, 400, 3], [2, 3, 300]]
    verbatim = information("g2o")
    assert verbatim[0, np.triu_indices(6)[0], np.triu_indices(6)[1]].tolist() == [float(n) for n in UPPER_3.split()]
    assert (verbatim == verbatim.mT).all()
    half = np.array([1, 1, 1, 2, 2, 2])
    for convention in CONVENTIONS:
        expected = verbatim / (half[:, None] * half) if convention == "log" else verbatim
        assert np.array_equal(information(convention), expected)
        assert np.array_equal(information(convention, PLANE), information("g2o", PLANE))


@for_all(w=["0.99998", "1.0005", "0.999995", "1"])
def test_rounded_quaternions_are_kept_with_a_warning(w: str, tmp_path: Path) -> None:
    warned = w in ("0.99998", "1.0005")
    text = f"{V3} 0 {Q}\n{V3} 1 0 0 0 0 0 0 {w}\n# c\nEDGE_SE3:QUAT 0 1 0 0 0 0 0 0 {w} {UPPER_3}\n"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        graph, values, report = load(write(tmp_path, text))
    notes = [note for note in report.notes if "length" in note]
    assert [str(c.message) for c in caught] == [f"{tmp_path / 'graph.g2o'}: {note}" for note in notes]
    assert len(caught) == warned
    if warned:
        assert "the length of 2 quaternions is off by more than 1e-05, first on line 2" in report.notes[-1]
    assert values[x[1]][-1] == graph.factors[0].z[0, -1] == float(w)  # type: ignore[attr-defined]


@for_all(line=["{k}.5,{k},7", "{k} 1 2", "word-{k}-word-{k}-word-{k}-word-{k}-word-{k}-word-{k}-{k}"])
def test_a_large_table_is_refused_by_a_few_calls_a_line(line: str) -> None:
    """However many lines there are: no line is compared with all others."""
    n = 5_000
    data = "\n".join(line.format(k=n + k) for k in range(n)).encode()
    with Profile() as calls:
        with pytest.raises(GraphFileError, match="is no graph"):
            read_graph(data, "f.csv")
        _, _, report = read_graph(TWO.encode() + data, "f.csv")
    assert sum(entry.callcount for entry in calls.getstats()) < 100 * n
    assert "unknown tags" in report.warnings[0]
    assert len(report.ignored) == n


def test_neighbors_of_extreme_ids() -> None:
    low, high = -(2**63), 2**63 - 1
    edges = [(low, high), (high, low), (low, low + 1), (high, high - 1), (high, 0), (0, low)]
    graph, values, _ = read("\n".join(f"EDGE_SE2 {i} {j} 1 0 0 {INFORMATION_2}" for i, j in edges))
    assert closures(graph, values, set(values.stacks))[1] == 4
