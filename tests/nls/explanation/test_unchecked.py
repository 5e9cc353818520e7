"""What nothing else checks: beliefs without a cure, and for the rest a cure that works when it is followed."""

from __future__ import annotations

import numpy as np
import pytest

import nls
from factors import XYH, ZPR, BearingRange, Between, Diagonal, Factor, Heading, Isotropic, Position, Prior, Shifted
from models import SE2, SE3, R
from nls import FactorGraph, Finding, Values

x, l, c = nls.kinds("x", "l", "c")
N = 6
I = np.arange(N)
STEPS = XYH(x[I[:-1]], x[I[1:]], np.tile([1.0, 0, 0], (N - 1, 1)), Diagonal([0.1, 0.1, 0.01]))
CLOSURE = XYH(x[0], x[N - 1], [N - 1.0, 0, 0], Diagonal([0.1, 0.1, 0.01]))
DEPTHS = ZPR(x[I], np.zeros((N, 3)), Diagonal([0.1, 0.01, 0.01]))
AGAIN = ZPR(x[I], np.full((N, 3), 0.005), Diagonal([0.1, 0.01, 0.01]))  # by a second sensor
ANCHOR = (
    Position(x[0], [0.0, 0.0], Diagonal([0.01, 0.01]), components=("x", "y")),
    Heading(x[0], 0.0, Diagonal([0.001])),
)


def values(**more: np.ndarray) -> Values:
    X = SE3.identity(N)
    X[:, 0] = I
    return Values({x: (SE3, X)} | {nls.kinds(name)[0]: (R(z.shape[1]), z) for name, z in more.items()})


def unchecked(start: Values, *factors: Factor) -> dict[str, Finding]:
    """The findings about what nothing checks, by the only cure of each; empty of what is believed."""
    found = [f for f in nls.explain(FactorGraph(factors), start).findings if f.kind == "unchecked"]
    assert all(f.numbers["believed"] == (not f.advice) for f in found)
    assert all(len(f.advice) <= 1 for f in found)
    return {f.advice[0].action if f.advice else "": f for f in found}


def test_an_anchor_is_believed_and_a_second_depth_sensor_checks_depth_rows() -> None:
    found = unchecked(values(), STEPS, CLOSURE, DEPTHS, *ANCHOR)
    assert found.keys() == {"", "second sensor"}
    assert found[""].numbers["factors"] == ("Position(x0)", "Heading(x0)")
    assert found["second sensor"].numbers["count"] == N
    assert unchecked(values(), STEPS, CLOSURE, DEPTHS, AGAIN, *ANCHOR).keys() == {""}


def test_priors_of_all_poses_are_believed() -> None:
    """As those of a vehicle whose attitude nothing measures."""
    level = Prior(x[I], SE3.identity(), Diagonal([0.1, 0.01, 0.01]), components=("z", "roll", "pitch"))
    found = unchecked(values(), STEPS, CLOSURE, level, *ANCHOR)
    assert found.keys() == {""}
    assert found[""].numbers["count"] == N + 2


def test_a_lone_fix_is_believed_and_two_fixes_check_each_other() -> None:
    fix = Position(x[3], [3.0, 0.0], Diagonal([1.0, 1.0]), components=("x", "y"))
    found = unchecked(values(), STEPS, CLOSURE, DEPTHS, fix, ANCHOR[1])
    assert found[""].numbers["factors"] == ("Position(x3)", "Heading(x0)")
    fixes = Position(x[[1, 3]], [[1.0, 0.0], [3.0, 0.0]], Diagonal([1.0, 1.0]), components=("x", "y"))
    assert unchecked(values(), STEPS, CLOSURE, DEPTHS, fixes, ANCHOR[1]).keys() == {"second sensor"}


def test_the_anchor_of_every_part_is_believed() -> None:
    i, j = np.array([0, 1, 2, 10, 11, 12]), np.array([1, 2, 0, 11, 12, 10])
    ring = Between(x[i], x[j], np.tile([[1, 0, 2 * np.pi / 3]], (6, 1)), Isotropic(0.1))
    graph = FactorGraph([ring, Prior(x[[0, 10]], np.zeros((2, 3)), Isotropic(0.01))])
    start = Values({x: (SE2, np.zeros((6, 3)), [0, 1, 2, 10, 11, 12])})
    (finding,) = (f for f in nls.explain(graph, graph.optimize(start).values).findings if f.kind == "unchecked")
    assert finding.numbers["believed"]
    assert finding.numbers["count"] == 2


@pytest.mark.parametrize("count", [1, 2])
def test_the_prior_of_a_calibration_that_nothing_tells_is_believed(count: int) -> None:
    slope = np.tile([[1.0], [0.0], [0.0]], (N - 1, 1, 1))
    steps = Shifted(STEPS, slope, c[np.arange(N - 1) % count])
    prior = Prior(c[np.arange(count)], np.zeros((count, 1)), Isotropic(0.01))
    found = unchecked(values(c=np.zeros((count, 1))), steps, DEPTHS, AGAIN, *ANCHOR, prior)
    assert set(found[""].numbers["factors"]) >= {f"Prior(c{k})" for k in range(count)}


def test_a_point_is_checked_from_another_place_and_a_loose_end_by_a_closure() -> None:
    point, noise = np.array([[2.0, 3.0, 0.0]]), Diagonal([0.01, 0.01, 0.1])
    z = np.array([[np.arctan2(3, 2 - k), 0, np.hypot(3, 2 - k)] for k in (1, 4)])
    found = unchecked(values(l=point), STEPS, DEPTHS, AGAIN, *ANCHOR, BearingRange(x[1], l[0], z[0], noise))
    assert found["view"].numbers["factors"] == ("BearingRange(x1, l0)",)
    assert found["close"].numbers["count"] == N - 1
    both = BearingRange(x[[1, 4]], l[[0, 0]], z, noise)
    assert "view" not in unchecked(values(l=point), STEPS, DEPTHS, AGAIN, *ANCHOR, both)
    assert "close" not in unchecked(values(), STEPS, CLOSURE, DEPTHS, AGAIN, *ANCHOR)
