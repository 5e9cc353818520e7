"""Small random graphs for the tests of the engine: every space, loops, duplicates, mixed sizes, odd ids."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from factors import Between, Diagonal, Factor, Information, Isotropic, Noise, Prior
from factors.base import Jacobians
from factors.keys import Keys
from models import SE2, SE3, SO2, SO3, LieGroup, Manifold, R
from models.algebra import Array, Index
from nls import FactorGraph, LinearSystem, Result, Status, Values, kinds

GROUPS: tuple[LieGroup, ...] = (R(1), R(2), R(3), SO2, SE2, SO3, SE3)
POSES: tuple[LieGroup, ...] = (R(2), SE2, SE3)
ODD = (40, 7, 8, -3, 1000, 2**40, 12, 9)  # neither consecutive nor sorted

x, l, y, p = kinds("x", "l", "y", "p")


@dataclass(frozen=True)
class Sample:
    """A graph with a start near the truth it was measured from."""

    graph: FactorGraph
    values: Values
    truth: Values


def walk(group: LieGroup, n: int, rng: np.random.Generator) -> Array:
    """A random trajectory (n, size) of steps of about 1 m and 0.3 rad, not from the identity."""
    X = [group.exp(0.5 * rng.normal(size=(1, group.dim)))]
    for _ in range(n - 1):
        step = 0.3 * rng.normal(size=(1, group.dim))
        step[:, 0] += 0.7
        X.append(group.compose(X[-1], group.exp(step)))
    return np.concatenate(X)


def moved(group: LieGroup, X: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Every element of a stack moved by a random tangent step."""
    return group.retract(X, sigma * rng.normal(size=(len(X), group.dim)))


def informations(n: int, d: int, rng: np.random.Generator) -> Array:
    """Random full positive definite matrices (n, d, d), of sigmas about 0.1."""
    W = 3 * np.eye(d) + 2 * rng.normal(size=(n, d, d))
    return np.asarray(W.mT @ W + 10 * np.eye(d))


def measured(
    group: LieGroup, X: Array, numbers: npt.NDArray[np.int64], i: list[int], j: list[int], noise: Noise, seed: int
) -> Between:
    """Edges from places i to places j of the trajectory X, measured with a sigma of 0.05."""
    z = moved(group, group.between(X[i], X[j]), 0.05, np.random.default_rng(seed))
    return Between(x[numbers[i]], x[numbers[j]], z, noise)


def pose_graph(
    group: LieGroup,
    n: int = 8,
    seed: int = 0,
    anchored: bool = True,
    numbers: tuple[int, ...] | None = None,
    start: float = 0.05,
) -> Sample:
    """A chain with loop closures: full informations, a duplicate, an edge both ways; a prior if anchored."""
    rng = np.random.default_rng(seed)
    X = walk(group, n, rng)
    number = np.arange(n, dtype=np.int64) if numbers is None else np.array(numbers[:n], dtype=np.int64)
    chain = list(range(n - 1))
    closures_i, closures_j = [0, n - 1, 1, n - 2, 0], [n - 1, 1, n - 2, 1, n - 1]  # (0, n-1) twice; 1 and n-2 both ways
    d = group.dim
    graph = FactorGraph(
        [
            measured(group, X, number, chain, [k + 1 for k in chain], Diagonal(0.1 * np.arange(1, d + 1)), seed + 1),
            measured(group, X, number, closures_i, closures_j, Information(informations(5, d, rng)), seed + 2),
            measured(group, X, number, [2], [3], Isotropic(0.3), seed + 3),  # again a neighbor, in a batch of its own
        ]
    )
    if anchored:
        graph.add(Prior(x[number[2]], moved(group, X[2:3], 0.05, rng), Isotropic(0.2)))
    values = Values({x: (group, moved(group, X, start, rng), number)})
    return Sample(graph, values, Values({x: (group, X, number)}))


def two_components(anchored: bool = False) -> Sample:
    """Trajectories of the plane that nothing joins, x0 ... x7 and x50 ... x57, the first of them anchored or not."""
    first, other = pose_graph(SE2, seed=5, anchored=anchored), pose_graph(SE2, seed=6, anchored=False)
    graph = FactorGraph(first.graph.factors)
    for f in between(other):
        graph.add(Between(x[f.keys[0].numbers + 50], x[f.keys[1].numbers + 50], f.z, f.noise))
    values = Values({x: (SE2, np.concatenate([first.values[x], other.values[x]]), [*range(8), *range(50, 58)])})
    return Sample(graph, values, values)


class Seen(Factor):
    """A point in the frame of a pose of the plane: h = R'(l - t), H_x = [-I, (h_2, -h_1)'], H_l = R'."""

    slots = (SE2, R(2))
    relative = True

    def __init__(self, pose: Keys, point: Keys, z: npt.ArrayLike, noise: Noise) -> None:
        super().__init__([pose, point], z, noise)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(2)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        pose, point = X
        Rt = SE2.rotation(pose).mT
        h = (Rt @ (point - pose[:, :2])[..., None])[..., 0]
        H = np.zeros((len(h), 2, 3))
        H[:, 0, 0] = H[:, 1, 1] = -1.0
        H[:, 0, 2], H[:, 1, 2] = h[:, 1], -h[:, 0]
        return h, (H, Rt)


class WrongSign(Between):
    """Between with both Jacobians negated: what a user's mistake looks like."""

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        h, H = super().predict(manifolds, *X)
        assert H is not None
        assert H[0] is not None
        return h, (-H[0], -np.eye(manifolds[0].dim)[None])


def in_frame(pose: Array, point: Array) -> Array:
    """The point as seen from the pose, R'(l - t), as a user would write it."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    dx, dy = point[:, 0] - pose[:, 0], point[:, 1] - pose[:, 1]
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)


def mixed(seed: int = 0, held: bool = False) -> Sample:
    """Poses of the plane, points and scalars under odd ids; factors over one, two and three variables."""
    rng = np.random.default_rng(seed)
    n, k = 6, 4
    X, L, scale = walk(SE2, n, rng), 3 * rng.normal(size=(k, 2)), np.array([[1.1], [0.9]])
    number, points, scalars = np.array(ODD[:n]), np.array([5, -1, 77, 6]), np.array([3, 2])
    i, j = rng.integers(0, n, 14), np.tile(np.arange(k), 4)[:14]
    z = in_frame(X[i], L[j]) + 0.05 * rng.normal(size=(14, 2))
    full = Information(informations(4, 3, rng))
    graph = FactorGraph([measured(SE2, X, number, [0, 2, 2, 4], [1, 1, 3, 3], full, seed)])

    def reprojected(pose: Array, point: Array) -> Array:
        return z - in_frame(pose, point)

    def triple(a: Array, point: Array, s: Array) -> Array:
        return s * in_frame(a, point) - in_frame(X[[5, 5]], L[[0, 2]])

    graph.add(Factor.from_function(reprojected, [x[number[i]], l[points[j]]], 2, Isotropic(0.1)))
    a, c = [4, 5, 5, 4], [3, 3, 1, 1]
    graph.add(Seen(x[number[a]], l[points[c]], in_frame(X[a], L[c]), Isotropic(1)))
    graph.add(Factor.from_function(triple, [x[number[[5, 5]]], l[points[[0, 2]]], y[scalars]], 2, Diagonal([0.1, 0.2])))
    graph.add(Prior(x[number[[0, 3]]], X[[0, 3]], Diagonal([0.1, 0.2, 0.05])))
    graph.add(Prior(l[points[2]], [L[2, 1]] * 0 + L[2].tolist(), Isotropic(0.1), components=["y"]))
    graph.add(Prior(y[scalars], scale, Isotropic(0.5)))
    if held:
        graph.fix(x[number[[1, 4]]])
        graph.fix(l[points[0]])
    truth = Values({l: (R(2), L, points), x: (SE2, X, number), y: (R(1), scale, scalars)})
    values = Values(
        {
            l: (R(2), L + 0.1 * rng.normal(size=L.shape), points),
            x: (SE2, moved(SE2, X, 0.05, rng), number),
            y: (R(1), scale + 0.1, scalars),
        }
    )
    return Sample(graph, values, truth)


SAMPLES: dict[str, Callable[[], Sample]] = {
    **{f"{group}": (lambda group=group: pose_graph(group, seed=1)) for group in GROUPS},
    **{f"{group} odd ids": (lambda group=group: pose_graph(group, seed=2, numbers=ODD)) for group in POSES},
    "two poses": lambda: pose_graph(SE2, n=4, seed=3),
    "mixed": lambda: mixed(4),
    "mixed, some fixed": lambda: mixed(5, held=True),
}


def between(sample: Sample) -> list[Between]:
    """The relative measurements of a sample."""
    return [f for f in sample.graph.factors if isinstance(f, Between)]


def forgotten(values: Values, place: float = 0.5) -> Values:
    """The points l at one place."""
    return values.replaced({l: np.full_like(values[l], place)})


def distance(group: LieGroup, X: Array, Y: Array) -> float:
    """Largest tangent component between two stacks, element by element."""
    return float(np.abs(group.local(X, Y)).max(initial=0.0))


def scalar(
    residual: Callable[[Array], Array],
    start: npt.ArrayLike,
    jacobian: Callable[[Array], Array] | None = None,
    dim: int = 1,
) -> tuple[FactorGraph, Values]:
    """One variable p0, a number or several, and a residual of it."""
    jacobians = None if jacobian is None else (lambda X: [jacobian(X)])
    graph = FactorGraph([Factor.from_function(residual, p[0], dim, jacobians=jacobians)])
    return graph, Values({p: (R(np.size(start)), [np.atleast_1d(start)])})


def cube(side: int) -> tuple[Index, Index]:
    """Pairs of neighbors among side^3 nodes: of all graphs of its size one with the worst fill."""
    number = np.arange(side**3).reshape(side, side, side)
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:]), (number[:, :, :-1], number[:, :, 1:])]
    u, v = (np.concatenate([pair[s].reshape(-1) for pair in pairs]) for s in (0, 1))
    return u, v


def circle() -> tuple[FactorGraph, Values]:
    """Distances to three beacons that do not agree: a smooth problem with a positive optimum."""
    beacons, measured = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]]), np.array([5.0, 8.3, 6.5])
    graph = FactorGraph([Factor.from_function(lambda X: np.linalg.norm(X - beacons, axis=1)[None] - measured, p[0], 3)])
    return graph, Values({p: (R(2), [[8.0, 9.0]])})


def diagonal(system: LinearSystem) -> Array:
    """Diagonal of A'A (n,), and 1 for an unknown that nothing reacts to."""
    squares = np.square(system.column_norms)
    return np.where(squares > 0, squares, 1.0)


def never_worse(graph: FactorGraph, start: Values, result: Result) -> None:
    """P4: what comes back is the lowest of all that was evaluated, and its chi2 is its own."""
    assert result.chi2_initial == pytest.approx(graph.chi2(start), rel=1e-14)
    assert result.chi2_final <= result.chi2_initial
    assert result.chi2_final == min(it.chi2 for it in result.history)
    assert graph.chi2(result.values) == pytest.approx(result.chi2_final, rel=1e-12, abs=1e-300)
    assert result.converged is (result.status is Status.CONVERGED)
