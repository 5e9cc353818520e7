"""Measurements with a calibration: found with them, refused where it does not fit, and one batch of many."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import ElevationHinge, Factor, Heading, Isotropic, Position, Shifted
from factors.joined import joined
from factors.replaced import replaced
from models import SE2, R
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from tests.factors.evaluated import same

x, c, l = kinds("x", "c", "l")
RNG = np.random.default_rng(3)
VALUES = Values({x: (SE2, RNG.normal(size=(6, 3))), c: (R(1), [[0.3], [-0.2]])})
ARM = RNG.normal(size=(6, 2))
RATES = RNG.normal(size=(6, 2, 1))


def fixes(rows: slice | list[int]) -> Factor:
    i = np.arange(6)[rows]
    return Shifted(Position(x[i], np.zeros((len(i), 2)), Isotropic(0.1), offset=ARM[i]), RATES[i], c[i % 2])


def test_parts_joined_and_replaced_keep_rates_arms_and_calibrations() -> None:
    whole = fixes(slice(None))
    index = [4, 1]
    same(whole[index].chi2(VALUES), whole.chi2(VALUES)[index], atol=1e-12)
    (again,) = joined([VALUES.gather(fixes(part))[0] for part in ([0], [1, 2], [3, 4, 5])])
    same(again.chi2(VALUES), whole.chi2(VALUES), atol=1e-12)
    other = replaced(whole, keys=[x[[5, 4, 3, 2, 1, 0]], whole.keys[1]])
    assert isinstance(other, Shifted)
    assert other.factor.keys == other.keys[:1], "messages of the factor within name its variables"


def test_a_file_holds_one(tmp_path: Path) -> None:
    for form in ("npz", "json"):
        nls.save(tmp_path / f"a.{form}", FactorGraph([fixes(slice(None))]), VALUES)
        graph, values, _ = nls.load(tmp_path / f"a.{form}")
        same(graph.factors[0].chi2(values), fixes(slice(None)).chi2(VALUES), atol=0)


def test_what_does_not_fit_is_refused() -> None:
    compass = Heading(x[[0, 1]], [0.1, 0.2], Isotropic(0.1))
    for G, problem in ((np.ones((3, 1, 1)), r"shape \(3, 1, 1\)"), ([1.0], r"shape \(1,\)"), ([[np.nan]], "finite")):
        with pytest.raises(GraphError, match=problem):
            Shifted(compass, G, c[0])
    with pytest.raises(GraphError, match="2 rows and it measures"):
        Shifted(compass, [[1.0], [1.0]], c[0]).chi2(VALUES)
    with pytest.raises(GraphError, match=r"c0 is in R\(1\), expected R\(2\)"):
        Shifted(compass, [[1.0, 1.0]], c[0]).chi2(VALUES)
    for factor in (ElevationHinge(x[0], l[0], 0.1), Factor.from_function(lambda X: X, x[0], 3), "compass"):
        with pytest.raises(GraphError, match="expected a factor that measures"):
            Shifted(factor, [[1.0]], c[0])  # type: ignore[arg-type]


def test_a_clock_is_found_where_the_rates_differ() -> None:
    """Headings of a turn that speeds up, labelled 0.3 s late; poses are known."""
    t = np.arange(6.0)
    yaw, rate = 0.02 * t**2, 0.04 * t
    poses = Values({x: (SE2, np.column_stack([t, t, yaw])), c: (R(1), [0.0])})
    late = Shifted(Heading(x[np.arange(6)], yaw - 0.3 * rate, Isotropic(0.01)), -rate[:, None, None], c[0])
    result = FactorGraph([late], [x[np.arange(6)]]).optimize(poses)
    assert result.values[c[0]] == pytest.approx(0.3)
