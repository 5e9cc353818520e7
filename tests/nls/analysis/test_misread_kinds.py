"""Kinds of measurements read otherwise: named, with the readings that nothing tells apart."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, Diagonal, Isotropic, Position
from models import SE2
from nls import FactorGraph, Values, kinds
from nls.analysis.misread import misread_kinds
from tests.nls.graphs import walk
from tests.nls.misreadings import clean, misread, optimum

(x,) = kinds("x")
# a vehicle that only goes ahead has no y to flip
FORWARD = {("Between, steps", "transposed"), ("Between, steps", "y flipped"), ("Between, closures", "y flipped")}


def named(graph: FactorGraph, values: Values) -> set[tuple[str, str]]:
    return {(kind.kind, kind.reading) for kind in misread_kinds(graph, values)}


@pytest.mark.parametrize(
    ("name", "k", "reading", "expected"),
    [
        ("sphere", 1, "exchanged", {("Between, closures", "exchanged")}),
        ("manhattan", 0, "y flipped", FORWARD),
        ("subsea", 1, "transposed", {("Between", "transposed")}),
        ("subsea", 2, "mirrored", {("BearingRange", "mirrored"), ("Between", "y flipped")}),
        ("headings", 2, "mirrored", {("BearingRange", "mirrored")}),
        ("headings", 3, "transposed", {("Heading", "transposed")}),
        ("headings", 3, "x, y exchanged", {("Heading", "x, y exchanged")}),
        ("lines", 1, "y flipped", {("Wheels", "y flipped"), ("Line", "mirrored")}),
    ],
)
def test_a_kind_is_named(name: str, k: int, reading: str, expected: set[tuple[str, str]]) -> None:
    graph, start, right = clean(name, 0)
    wrong = misread(graph, start, k, reading)
    meant = misread_kinds(wrong, optimum(wrong, start))
    assert {(kind.kind, kind.reading) for kind in meant} <= expected
    (kind,) = (kind for kind in meant if (kind.reading, kind.places[0][0]) == (reading, k))
    assert kind.chi2 == pytest.approx(graph.chi2(right), rel=1e-3)
    assert kind.standing > 2 * kind.chi2


def test_fixes_in_another_frame_than_the_odometry() -> None:
    """North and east for east and north: with no heading that is the same as a mirrored odometry."""
    rng = np.random.default_rng(0)
    X, k = walk(SE2, 40, rng), np.arange(39)
    sigmas = np.array([0.05, 0.05, 0.02])
    z = SE2.retract(SE2.between(X[:-1], X[1:]), sigmas * rng.normal(size=(39, 3)))
    fixes = Position(x[0:40], X[:, 1::-1] + 0.1 * rng.normal(size=(40, 2)), Isotropic(0.1))
    graph = FactorGraph([Between(x[k], x[k + 1], z, Diagonal(sigmas)), fixes])
    meant = named(graph, optimum(graph, Values({x: (SE2, X)})))
    assert meant >= {("Between", "y flipped"), ("Position", "y flipped"), ("Position", "x, y exchanged")}


def test_other_mistakes_are_not_named() -> None:
    """Wrong sigmas, wrong closures, degrees."""
    graph, start, _ = clean("manhattan", 0)
    odometry, closures = graph.factors
    assert isinstance(odometry, Between)
    assert isinstance(closures, Between)
    i, j = odometry.keys
    sharp = Between(i, j, odometry.z, Isotropic(0.004))
    degrees = Between(i, j, odometry.z * [1, 1, 180 / np.pi], odometry.noise)
    wrong = closures[np.arange(20)]
    shuffled = Between(wrong.keys[0], wrong.keys[1], np.add(wrong.z[::-1], [3.0, 1.0, 1.0]), wrong.noise)
    for factors in ([sharp, closures], [degrees, closures], [odometry, closures[20:], shuffled]):
        wrong_graph = FactorGraph(factors)
        assert named(wrong_graph, optimum(wrong_graph, start)) == set()
