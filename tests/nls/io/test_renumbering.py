"""New numbers for variables whose numbers clash: poses keep theirs, and every old name is in a note."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Between, BetweenSensors, Isotropic, Landmark, Range
from models import SE2, Manifold, R
from nls import FactorGraph, Values, kinds
from nls.io.variable_names import renumbered
from tests.nls.missions.charts.charted import charted

x, l, o = kinds("x", "l", "o")


def test_in_python_a_warning_says_which_variable_was_which(tmp_path: Path) -> None:
    scene = charted()
    with pytest.warns(nls.GraphWarning, match=r"a\.g2o: \d+ variables have new numbers: l\d+ to l\d+ were l0 to l\d"):
        nls.save(tmp_path / "a.g2o", scene.graph, scene.start, renumber=True)
    again, values, _ = nls.load(tmp_path / "a.g2o", "log")
    assert again.chi2(values) == pytest.approx(scene.graph.chi2(scene.start), rel=1e-12)
    graph, same, notes = renumbered(again, values)  # nothing clashes any more
    assert (graph, same, notes) == (again, values, [])


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


def test_what_is_given_is_not_changed() -> None:
    graph, values = sensors()
    before = [repr(factor) for factor in graph.factors]
    renumbered(graph, values)
    assert [repr(factor) for factor in graph.factors] == before
    assert values.stack(l).numbers.tolist() == [0, 5]


def test_numbers_beyond_the_largest_are_the_first_that_are_free() -> None:
    most = 2**63 - 1
    graph = FactorGraph([Range(x[[0, 2]], l[[2, most]], [1.0, 2.0], Isotropic(0.1))])
    values = Values({x: (SE2, SE2.identity(2), [0, 2]), l: (R(2), np.ones((2, 2)), [2, most])})
    _, moved, notes = renumbered(graph, values)
    assert moved.stack(l).numbers.tolist() == [1, most]
    assert notes == ["1 variable has a new number: l1 was l2"]
