"""Names of variables in files: GTSAM's keys, c << 56 | k, come back as they were; numbers that clash are new ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Between, BetweenSensors, Isotropic, Landmark, Range
from models import SE2, SE3, LieGroup, Manifold, R
from nls import FactorGraph, Kind, Values, kinds
from nls.io.variable_names import renumbered
from tests.nls.graphs import pose_graph
from tests.nls.io import g2o_files
from tests.nls.io.g2o_files import LABEL, PLANE, ROBOTS, STEP, A, B, L, X, again, numbers, read, renamed, same, without


def test_a_file_of_two_robots_has_their_names_and_comes_back_byte_for_byte(tmp_path: Path) -> None:
    graph, values, report = read(ROBOTS)
    assert numbers(values) == {"a": [0, 1, 44], "b": [0, 1], "l": [3]}
    assert report.notes == ["ids are keys of GTSAM, a letter and a number in one: kinds a, b, l"]
    places = {report.place(n, k): f.describe(k)[-8:] for n, f in enumerate(graph.factors) for k in range(len(f))}
    ends = ["(a0, a1)", "(b0, b1)", "(b1, l3)", "a1, a44)", "a44, b0)", "(a1, l3)"]
    assert places == {f"f.g2o:{line}": end for line, end in enumerate(ends, 9)}
    assert [repr(keys) for keys in graph.fixed] == ["a0"]
    same((graph, values, report), again((graph, values, report), tmp_path))
    assert (tmp_path / "again.g2o").read_text() == ROBOTS


@pytest.mark.parametrize("group", [SE2, SE3])
@pytest.mark.parametrize("vertices", [True, False])
def test_two_robots_have_the_optimum_of_plain_ids(group: LieGroup, vertices: bool, tmp_path: Path) -> None:
    """Starts, certificate and gnc take several kinds of poses."""
    sample = pose_graph(group, anchored=False)
    nls.save(tmp_path / "plain.g2o", sample.graph, sample.values)
    text = (tmp_path / "plain.g2o").read_text()
    text = text if vertices else without(text, "VERTEX")
    one, two = read(text), read(renamed(text, lambda n: A | n if n < 4 else B | n - 4))
    assert numbers(two[1]) == {"a": [0, 1, 2, 3], "b": [0, 1, 2, 3]}
    assert two[0].chi2(two[1]) == pytest.approx(one[0].chi2(one[1]), rel=1e-12)
    results = [graph.optimize(nls.initialize(graph, values)[0]) for graph, values, _ in (one, two)]
    assert results[1].chi2_final == pytest.approx(results[0].chi2_final, rel=1e-9)
    joined = np.concatenate([results[1].values[Kind(kind)] for kind in "ab"])
    assert joined == pytest.approx(results[0].values[Kind("x")], abs=1e-6)
    proofs = [nls.certify(loaded[0], result.values) for loaded, result in zip((one, two), results, strict=True)]
    assert [proof.verdict for proof in proofs] == ["certified"] * 2
    assert proofs[1].chi2_reached == pytest.approx(proofs[0].chi2_reached, rel=1e-9)
    chosen = [nls.gnc(graph, values, preselect=False).result.chi2_final for graph, values, _ in (one, two)]
    assert chosen[1] == pytest.approx(chosen[0], rel=1e-6)
    with pytest.raises(nls.GraphError, match="no odometry connects a3 to b0: the graph has 2 sessions"):
        nls.gnc(*two[:2])


def test_plain_ids_beside_keys_and_labels(tmp_path: Path) -> None:
    """Poses by number and landmarks by key are x and l; LabeledSymbol's label is a second letter."""
    text = f"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY {L} 2 1\nVERTEX_SE2 {A | LABEL | 7} 1 1 0\n"
    text += f"EDGE_SE2 0 1 {STEP}\nEDGE_SE2_XY 0 {L} 2 1 4 0 4\nEDGE_SE2 1 {A | LABEL | 7} {STEP}\n"
    loaded = read(text)
    assert numbers(loaded[1]) == {"x": [0, 1], "aB": [7], "l": [0]}
    assert loaded[0].factors[0].describe(0) == "Between(x0, x1)"
    same(loaded, again(loaded, tmp_path))
    written = (tmp_path / "again.g2o").read_text().splitlines()
    assert sorted(written) == sorted(text.splitlines())
    assert written[-3:] == text.splitlines()[-3:]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (f"VERTEX_SE2 5 0 0 0\nVERTEX_SE2 {X | 5} 1 0 0\nEDGE_SE2 5 {X | 5} {STEP}", "x would be two kinds"),
        (f"VERTEX_SE2 {L} 0 0 0\nVERTEX_XY {L | 1} 1 0\nEDGE_SE2_XY {L} {L | 1} 1 0 1 0 1", "l would be two kinds"),
        (f"VERTEX_SE2 {A} 0 0 0\nVERTEX_SE2 {1 << 62} 1 0 0\nEDGE_SE2 {A} {1 << 62} {STEP}", "others are neither"),
        (f"VERTEX_SE2 {A} 0 0 0\nVERTEX_SE2 {A | 1 << 48} 1 0 0\nEDGE_SE2 {A} {A | 1 << 48} {STEP}", "are neither"),
    ],
)
def test_what_is_no_key_for_sure_stays_a_number(text: str, why: str, tmp_path: Path) -> None:
    graph, values, report = read(text)
    assert set(values.stacks) <= {"x", "l"}
    assert "kept as numbers" in report.notes[0]
    assert why in report.notes[0]
    same((graph, values, report), again((graph, values, report), tmp_path))
    assert (tmp_path / "again.g2o").read_text() == text + "\n"


def test_ids_below_2_to_56_and_files_of_them_stay_as_they_are(tmp_path: Path) -> None:
    for largest in ((1 << 56) - 1, (1 << 63) - 1):
        loaded = read(renamed(PLANE, lambda n, largest=largest: n if n < 3 else largest))
        assert (list(loaded[1].stacks), loaded[2].notes, loaded[2].gtsam_kinds) == (["x"], [], ())
        same(loaded, again(loaded, tmp_path))


@pytest.mark.parametrize("letter", "xlo")
def test_poses_may_have_every_letter(letter: str, tmp_path: Path) -> None:
    """Also those of our own kinds of points and of places of sensors."""
    head = ord(letter) << 56
    loaded = read(f"EDGE_SE2 {head} {head | 1} {STEP}\nEDGE_SE2 {head | 1} {A} {STEP}\n")
    assert numbers(loaded[1]) == {letter: [0, 1], "a": [0]}
    same(loaded, again(loaded, tmp_path))


def test_graphs_made_in_python_get_keys_where_g2o_has_no_ids(tmp_path: Path) -> None:
    """A place of a sensor is one by its use."""
    a, b, m, s, x, l = kinds("a", "b", "m", "s", "x", "l")
    step = BetweenSensors(a[0], a[1], [1.0, 0.2, 0.1], Isotropic(0.1), s[0])
    view = Landmark(b[[0]], m[[0]], [[2.0, 1.0]], Isotropic(0.1))
    graph = FactorGraph([step, view, Between(a[1], b[0], [1.0, 0.1, 0.2], Isotropic(0.1))], [b[0]])
    poses = [[0.0, 0.0, 0.0], [1.1, 0.1, 0.1]]
    values = Values({a: (SE2, poses), b: (SE2, poses[:1]), s: (SE2, [[0.3, 0.1, 0.2]]), m: (R(2), [[3.0, 1.0]])})
    nls.save(tmp_path / "a.g2o", graph, values)
    read_back, its, _ = nls.load(tmp_path / "a.g2o", "log")
    assert numbers(its) == {"a": [0, 1], "b": [0], "m": [0], "s": [0]}
    assert read_back.chi2(its) == pytest.approx(graph.chi2(values), rel=1e-12)
    with pytest.raises(nls.GraphError, match="a281474976710656 is no key of GTSAM: its number must be"):
        nls.save(tmp_path / "b.g2o", FactorGraph(), Values({a: (SE2, poses, [1, 1 << 48])}))
    lost = Values({a: (SE2, poses), b: (SE2, poses[:1]), s: (SE2, [[0.3, 0.1, 0.2]] * 2), m: (R(2), [[3.0, 1.0]])})
    with pytest.raises(nls.GraphError, match="s1 is no offset of any measurement"):
        nls.save(tmp_path / "b.g2o", graph, lost)
    with pytest.raises(nls.GraphError, match="x0 and l0 have one number"):
        nls.save(tmp_path / "b.g2o", FactorGraph(), Values({x: (SE2, poses), l: (R(2), [[0.0, 0.0]])}))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"EDGE_SE2 {A | 44} {B | 9} {STEP}", f"the edge needs vertex b9 ({B | 9}), which no VERTEX_SE2 line has"),
        (f"FIX {B | 9}", f"FIX names vertex b9 ({B | 9})"),
        (f"EDGE_SE2 {A | 44} {L | 3} {STEP}", f"vertex l3 ({L | 3}) is a point"),
    ],
)
def test_refusals_name_the_keys(line: str, words: str) -> None:
    g2o_files.assert_refused(15, words, read, ROBOTS + line + "\n")


def test_the_tracks_of_two_robots_are_told_apart_in_a_picture() -> None:
    pytest.importorskip("matplotlib")
    axes = nls.plot.trajectory(*read(ROBOTS)[:2]).axes[0]
    tracks = [line for line in axes.lines if str(line.get_label()).startswith("trajectory")]
    assert [line.get_label() for line in tracks] == ["trajectory a", "trajectory b"]
    assert len({line.get_color() for line in tracks}) == 2


x, l, o = kinds("x", "l", "o")


def sensors() -> tuple[FactorGraph, Values]:
    """Poses, points and the place of a sensor, all of them numbered from 0; one of every kind held."""
    step = BetweenSensors(x[0], x[1], [1.0, 0.2, 0.1], Isotropic(0.1), o[0])
    view = Landmark(x[[0, 1]], l[[0, 5]], [[2.0, 1.0], [1.0, 2.0]], Isotropic(0.1), o[0])
    graph = FactorGraph([step, view, Between(x[0], x[1], [1.0, 0.1, 0.2], Isotropic(0.1))], [x[1], l[0], o[0]])
    stacks: dict[object, tuple[Manifold, object, object]] = {
        l: (R(2), [[3.0, 1.0], [2.0, 4.0]], [0, 5]),
        o: (SE2, [[0.3, 0.1, 0.2]], [0]),
        x: (SE2, [[0.0, 0.0, 0.0], [1.1, 0.1, 0.1]], [0, 1]),
    }
    return graph, Values(stacks)  # type: ignore[arg-type]


def test_places_of_sensors_get_numbers_of_their_own_and_stay_offsets(tmp_path: Path) -> None:
    graph, values = sensors()
    other, moved, (note,) = renumbered(graph, values)
    assert note == "2 variables have new numbers: o6 was o0, l7 was l0"
    assert {kind: stack.numbers.tolist() for kind, stack in moved.stacks.items()} == {
        "l": [7, 5],
        "o": [6],
        "x": [0, 1],
    }
    assert [f.offset == f.keys[2] for f in other.factors[:2]] == [True, True]  # type: ignore[attr-defined]
    assert [repr(keys) for keys in other.fixed] == ["x1", "l7", "o6"]
    assert other.chi2(moved) == graph.chi2(values) > 0
    with pytest.warns(nls.GraphWarning, match="o6 was o0, l7 was l0"):
        nls.save(tmp_path / "a.g2o", graph, values, renumber=True)
    read, its, _ = nls.load(tmp_path / "a.g2o", "log")
    assert read.chi2(its) == pytest.approx(graph.chi2(values), rel=1e-12)
    assert renumbered(read, its) == (read, its, [])  # nothing clashes any more


def test_numbers_beyond_the_largest_are_the_first_that_are_free() -> None:
    most = 2**63 - 1
    graph = FactorGraph([Range(x[[0, 2]], l[[2, most]], [1.0, 2.0], Isotropic(0.1))])
    values = Values({x: (SE2, SE2.identity(2), [0, 2]), l: (R(2), np.ones((2, 2)), [2, most])})
    _, moved, notes = renumbered(graph, values)
    assert moved.stack(l).numbers.tolist() == [1, most]
    assert notes == ["1 variable has a new number: l1 was l2"]
