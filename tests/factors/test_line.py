"""Line: both normals of a wall, walls seen past their ends, where the sensor sits, starts, what is refused."""

from __future__ import annotations

from math import pi

import numpy as np
import numpy.typing as npt
import pytest

from factors import Between, Diagonal, Isotropic, Line, Prior, check_jacobians
from factors.keys import Keys
from models import LINE, SE2, R
from models.algebra import wrap
from models.errors import GraphError
from models.sensors import line_in_frame, normalized
from nls import FactorGraph, Values, kinds
from nls.starts import locate_points
from tests.combinations import for_all
from tests.factors.evaluated import refused, same

Array = npt.NDArray[np.float64]
x, l, o = kinds("x", "l", "o")
NOISE = Diagonal(alpha=0.01, r=0.03)
WALLS = np.array([[0.0, 6.0], [pi / 2, 4.0], [-2.2, 3.0]])
MOUNT = np.array([0.4, -0.2, 2.5])


def drive(n: int = 25) -> Array:
    """Along y from (10, -3) to (10, 9): past the wall y = 4, whose extension is crossed, and outside of x = 6."""
    return np.column_stack([np.full(n, 10.0), np.linspace(-3, 9, n), np.linspace(1.4, 1.8, n)])


def sights(X: Array, O: Array | None = None) -> tuple[Keys, Keys, Array]:
    """Every wall from every pose, as a scanner reports it: r >= 0, whatever the normal of the wall."""
    i, k = (a.ravel() for a in np.indices((len(X), len(WALLS))))
    S = X[i] if O is None else SE2.compose(X[i], O)
    return x[i], l[k], normalized(line_in_frame(S, WALLS[k])[0])


def noisy(z: Array, seed: int) -> Array:
    return normalized(z + np.random.default_rng(seed).normal(0, [0.01, 0.03], z.shape))


def around(X: Array, seed: int, size: float = 0.1) -> Values:
    """Values near the truth, every second wall by its other normal."""
    rng = np.random.default_rng(seed)
    L = LINE.retract(WALLS, rng.normal(0, size, WALLS.shape))
    L[1::2] = np.column_stack([L[1::2, 0] + pi, -L[1::2, 1]])
    return Values({x: (SE2, SE2.retract(X, rng.normal(0, size, X.shape))), l: (LINE, L)})


def graph_of(X: Array, z: Array, pose: Keys, wall: Keys, walked: int | None = None) -> FactorGraph:
    """Odometry, exact unless seeded, and sightings."""
    step, sigmas, moved = np.arange(len(X) - 1), [0.02, 0.02, 0.01], SE2.between(X[:-1], X[1:])
    if walked is not None:
        moved = SE2.retract(moved, np.random.default_rng(walked).normal(0, sigmas, moved.shape))
    walk = Between(x[step], x[step + 1], moved, Diagonal(sigmas))
    return FactorGraph([Prior(x[0], X[0], Isotropic(1e-3)), walk, Line(pose, wall, z, NOISE)])


def test_the_sign_of_r_is_no_rule_where_an_extension_is_crossed() -> None:
    """The trap: near the crossing the sign of r' is that of the noise. By sign alone some sightings are 180 deg off."""
    X = drive(1001)
    pose, wall, exact = sights(X)
    h, _ = line_in_frame(X[pose.numbers], WALLS[wall.numbers])
    crossed = wall.numbers == 1
    assert h[crossed, 1].min() < -3 < 3 < h[crossed, 1].max()
    z = noisy(exact, 4)
    by_sign, by_angle = wrap(z[:, 0] - normalized(h)[:, 0]), LINE.local(h, z)
    assert (np.abs(by_sign) > 3).sum() >= 2
    assert (crossed & (np.abs(h[:, 1]) < 0.1))[np.abs(by_sign) > 3].all()
    assert np.abs(by_angle[:, 0]).max() < 0.05
    assert np.abs(by_angle[:, 1]).max() < 0.15


def test_walls_seen_past_their_ends_are_solved() -> None:
    X = drive(1001)
    pose, wall, exact = sights(X)
    graph, start = graph_of(X, noisy(exact, 4), pose, wall, walked=1), around(X, 2)
    result = graph.optimize(start)
    assert result.converged
    assert result.chi2_final == pytest.approx(result.dof, abs=5 * np.sqrt(2 * result.dof))
    same(LINE.local(WALLS, result.values[l]), 0.0, atol=0.05)
    same(result.values[x][:, :2], X[:, :2], atol=0.1)
    assert check_jacobians(graph.factors[2], start) < 1e-6


@for_all(offset=["none", "fixed", "variable"])
def test_lines_start_where_they_were_seen_first(offset: str) -> None:
    X = drive()
    O = None if offset == "none" else MOUNT
    pose, wall, z = sights(X, O)
    values = Values({x: (SE2, X), l: (LINE, LINE.identity(3)), o: (SE2, MOUNT)})
    factor = Line(pose, wall, z, NOISE, o[0] if offset == "variable" else O)
    found = locate_points(FactorGraph([factor]), values)
    same(LINE.local(WALLS, found[l]), 0.0, atol=1e-12)
    assert (found[x] == X).all()


def test_what_does_not_fit() -> None:
    for pose, wall, z, offset, named in (
        (R(2), LINE, np.ones((2, 2)), None, r"Line: x0 is in R\(2\), .* SE2"),
        (SE2, R(2), np.ones((2, 2)), None, r"Line: l0 is in R\(2\), .* LINE"),
        (SE2, LINE, np.ones((2, 3)), None, r"LINE: .*\(2, 3\), expected \(n, 2\)"),
        (SE2, LINE, np.ones((2, 2)), [1.0, 2.0], "offset: SE2"),
    ):
        values = Values({x: (pose, pose.identity(2)), l: (wall, wall.identity())})
        factor = Line(x[[0, 1]], l[0], z, NOISE, offset)
        refused(lambda values=values, factor=factor: values.gather(factor), GraphError, named)
