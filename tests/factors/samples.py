"""One or more samples of every factor: how to make it, and its measurement function once more, written by hand.

The conformity suite finds every Factor subclass by itself and fails when it has no sample here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from factors import Between, Factor, Noise, Prior, SequentialMatch, SqrtInformation
from factors.conventions import CONVENTIONS
from factors.keys import Keys
from models import LINE, S2, SE2, SE3, SO2, SO3, LieGroup, Manifold, R
from models.algebra import Array
from models.manifolds.measured import MeasuredNumbers
from models.manifolds.units import ANGLES
from nls import Values
from tests.factors.evaluated import error

GROUPS: list[LieGroup] = [SO2, SE2, SO3, SE3, R(2), R(3)]
STEP = 1e-5
NORMALS = ((0.0, 1.0), (np.pi, -1.0))
CASES = ["truth", "large innovation", "near identity", "residual near pi", "state near pi"]


@dataclass(frozen=True)
class Sample:
    """A factor that can be made for any number of measurements.

    space, dim : of the measurement, and numbers per residual.
    build : the factor of (keys, z, noise).
    truth : the measurement z (n, size) of the stacks of variables, not by way of the library's prediction.
    around : where the variables are, one element (size,) each; about the identity when omitted. It keeps targets away
        from the sensor, and puts bearings where they wrap.
    visible : takes the stacks of variables to others, in which the sensor sees its targets.
    """

    name: str
    manifolds: tuple[Manifold, ...]
    space: Manifold
    dim: int
    build: Callable[[tuple[Keys, ...], Array, Noise], Factor]
    truth: Callable[..., Array]
    convention: str = "log"
    around: tuple[Array, ...] | None = None
    visible: Callable[..., tuple[Array, ...]] | None = None

    def __str__(self) -> str:
        return self.name

    def factor(self, z: Array, noise: Noise) -> Factor:
        """Slot k takes the variables of kind vk, number 0 to n-1."""
        return self.build(tuple(Keys("abcd"[k], np.arange(len(z))) for k in range(len(self.manifolds))), z, noise)

    def values(self, X: tuple[Array, ...]) -> Values:
        return Values({"abcd"[k]: (manifold, X[k]) for k, manifold in enumerate(self.manifolds)})


def turned(manifold: Manifold, n: int, angle: float, length: float, rng: np.random.Generator) -> Array:
    """Random tangent steps of given angle and length."""
    delta = np.zeros((n, manifold.dim))
    angular = np.isin(manifold.components, list(ANGLES))
    for part, size in ((angular, angle), (~angular, length)):
        if part.any():
            v = rng.normal(size=(n, int(part.sum())))
            delta[:, part] = size * v / np.linalg.norm(v, axis=1, keepdims=True)
    return delta


def states(manifold: Manifold, n: int, case: str, rng: np.random.Generator, around: Array | None = None) -> Array:
    """Variables of a case."""
    centers = manifold.identity(n) if around is None else np.tile(around, (n, 1))
    angle, length = {"near identity": (1e-8, 1e-8), "state near pi": (np.pi - 1e-9, 3.0)}.get(case, (1.3, 3.0))
    return manifold.retract(centers, turned(manifold, n, angle, length, rng))


def situation(sample: Sample, case: str, n: int, seed: int) -> tuple[tuple[Array, ...], Array]:
    """Stacks of variables and a measurement as far from the prediction as the case says."""
    rng = np.random.default_rng(seed)
    around = sample.around or (None,) * len(sample.manifolds)
    X = tuple(states(m, n, case, rng, center) for m, center in zip(sample.manifolds, around, strict=True))
    X = X if sample.visible is None else sample.visible(*X)
    angle, length = {
        "truth": (0.0, 0.0),
        "large innovation": (2.0, 5.0),
        "near identity": (1e-7, 1e-7),
        "residual near pi": (np.pi - 1e-3, 2.0),
        "state near pi": (0.1, 0.1),
    }[case]
    z = np.asarray(sample.truth(*X), dtype=float)
    step = turned(sample.space, n, angle, length, rng)
    ranges = np.array(sample.space.components) == "range"
    step[:, ranges] = np.abs(step[:, ranges])  # none is below 0
    return X, sample.space.retract(z, step)


def whiteners(n: int, m: int, seed: int) -> Array:
    """A different full, well-conditioned, not symmetric W (n, m, m) for each measurement."""
    return np.eye(m) * 2 + np.random.default_rng(seed).uniform(-0.8, 0.8, size=(n, m, m))


def full_noise(n: int, m: int, seed: int) -> Noise:
    return SqrtInformation(whiteners(n, m, seed))


def around_each(sample: Sample, X: tuple[Array, ...], z: Array, W: Array, slot: int, step: float) -> Array:
    """b (2, dim, n, m) with one variable moved by a step along each of its axes, and back: one batch of all."""
    n, d = len(z), sample.manifolds[slot].dim
    moved = [np.tile(x, (2 * d, 1)) for x in X]
    steps = np.repeat(step * np.concatenate([np.eye(d), -np.eye(d)]), n, axis=0)
    moved[slot] = sample.manifolds[slot].retract(moved[slot], steps)
    many = sample.factor(np.tile(z, (2 * d, 1)), SqrtInformation(np.tile(W, (2 * d, 1, 1))))
    return error(many, sample.values(tuple(moved))).reshape(2, d, n, sample.dim)


def derivative(sample: Sample, X: tuple[Array, ...], z: Array, W: Array, slot: int) -> Array:
    """Of b (n, m, dim), by central differences."""
    plus, minus = around_each(sample, X, z, W, slot, STEP)
    return np.moveaxis((plus - minus) / (2 * STEP), 0, -1)


# Groups once more, one element at a time, by homogeneous matrices and SciPy's rotations.


def homogeneous(group: Manifold, X: Array) -> Array:
    """Stored element (size,) as a matrix."""
    if group is SO2 or group is SE2:
        *t, theta = X
        M = np.eye(3)
        M[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
        M[: len(t), 2] = t
    elif group is SO3 or group is SE3:
        M = np.eye(4)
        M[:3, :3] = Rotation.from_quat(X[-4:]).as_matrix()
        M[: len(X) - 4, 3] = X[:-4]
    else:
        M = np.eye(len(X) + 1)
        M[:-1, -1] = X
    return M


def stored(group: Manifold, M: Array) -> Array:
    """Matrix as stored element."""
    if group is SO2 or group is SE2:
        return np.array([*M[: group.size - 1, 2], np.arctan2(M[1, 0], M[0, 0])])
    if group is SO3 or group is SE3:
        return np.array([*M[: group.size - 4, 3], *Rotation.from_matrix(M[:3, :3]).as_quat()])
    return M[:-1, -1]


def file_vector(group: Manifold, M: Array) -> Array:
    """Translation and wrapped angle, or quaternion vector part with w >= 0."""
    if group is SO3 or group is SE3:
        q = Rotation.from_matrix(M[:3, :3]).as_quat()
        return np.array([*M[: group.size - 4, 3], *(q[:3] if q[3] >= 0 else -q[:3])])
    return stored(group, M)


def logarithm(group: Manifold, M: Array) -> Array:
    """(rho, phi), the translation by V rho = t V from exp [[K, I], [0, 0]] = [[R, V], [0, I]]."""
    if group is not SE2 and group is not SE3:
        return Rotation.from_matrix(M[:3, :3]).as_rotvec() if group is SO3 else stored(group, M)
    k = len(M) - 1
    if k == 2:
        phi = np.array([np.arctan2(M[1, 0], M[0, 0])])
        K = phi[0] * np.array([[0.0, -1.0], [1.0, 0.0]])
    else:
        phi = Rotation.from_matrix(M[:3, :3]).as_rotvec()
        K = np.cross(phi, np.eye(3)).T
    V = expm(np.block([[K, np.eye(k)], [np.zeros((k, 2 * k))]]))[:k, k:]
    return np.concatenate([np.linalg.solve(V, M[:k, k]), phi])


def innovation_by_hand(group: Manifold, h: Array, z: Array, convention: str) -> Array:
    """z [-] h of one measurement, in the four conventions."""
    if group is LINE:  # of its two normals that of z which is nearer to that of h
        both = [np.array([np.angle(np.exp(1j * (z[0] + turn - h[0]))), sign * z[1] - h[1]]) for turn, sign in NORMALS]
        return min(both, key=lambda e: abs(e[0]))
    if group is S2:  # the turn from z to h, about x and y as the shortest turn takes them from the pole next to z
        pole, turn = np.array([0.0, 0.0, np.copysign(1.0, z[2])]), np.cross(z, h)
        axes, _ = Rotation.align_vectors([z, np.cross(pole, z)], [pole, np.cross(pole, z)])
        angle = np.arctan2(np.linalg.norm(turn), z @ h)
        return np.asarray((axes.as_matrix().T @ turn)[:2] * (angle / np.linalg.norm(turn) if angle else 1.0))
    if isinstance(group, MeasuredNumbers):
        angular = np.isin(group.components, ["bearing", "azimuth", "elevation", "yaw", "pitch", "roll"])
        return np.where(angular, np.arctan2(np.sin(z - h), np.cos(z - h)), z - h)
    H, Z = homogeneous(group, h), homogeneous(group, z)
    if convention == "g2o":
        if group not in (SO2, SE2, SO3, SE3):
            return z - h
        return -file_vector(group, np.linalg.inv(Z) @ H)
    if convention == "graphslam":
        return file_vector(group, np.linalg.inv(H) @ Z)
    return logarithm(group, np.linalg.inv(H) @ Z)


def difference(group: Manifold) -> Callable[[Array, Array], Array]:
    def truth(X_i: Array, X_j: Array) -> Array:
        relative = [np.linalg.inv(homogeneous(group, a)) @ homogeneous(group, b) for a, b in zip(X_i, X_j, strict=True)]
        return np.array([stored(group, M) for M in relative])

    return truth


def between(group: LieGroup, convention: str, kind: type[Between] = Between) -> Sample:
    return Sample(
        f"{kind.__name__}-{group}-{convention}",
        (group, group),
        group,
        group.dim,
        lambda keys, z, noise: kind(*keys, z, noise, convention=convention),
        difference(group),
        convention,
    )


def prior(group: LieGroup, convention: str, components: tuple[str, ...] | None = None) -> Sample:
    return Sample(
        f"Prior-{group}-{convention}" + (f"-{'+'.join(components)}" if components else ""),
        (group,),
        group,
        len(components) if components else group.dim,
        lambda keys, z, noise: Prior(keys[0], z, noise, components, convention=convention),
        lambda X: X.copy(),
        convention,
    )


def _product(X: Array, L: Array) -> Array:
    """Two numbers of a pose and a point."""
    return X[:, :2] * np.sin(L)


def _product_jacobians(X: Array, L: Array) -> tuple[Array, Array]:
    return np.sin(L)[:, :, None] * SE2.world_axes(X)[:, :2], (X[:, :2] * np.cos(L))[:, :, None] * np.eye(2)


def _position(T: Array) -> Array:
    """Three numbers of a pose in space."""
    return np.stack([T[:, 0] * T[:, 1], np.sin(T[:, 2]), T[:, 2] + T[:, 0]], axis=1)


def from_function(name: str, manifolds: tuple[Manifold, ...], dim: int, f: Callable, J: Callable | None) -> Sample:
    """A factor of a function f has z = 0: the sample measures f(X) as f(X) - z for a z of its choice."""

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        return Factor.from_function(lambda *X: f(*X) - z, keys, dim, noise, J)

    return Sample(f"from_function-{name}", manifolds, R(dim), dim, build, f)


SAMPLES = [
    *(between(group, convention) for group in GROUPS for convention in CONVENTIONS),
    between(SE2, "log", SequentialMatch),
    *(prior(group, convention) for group in GROUPS for convention in CONVENTIONS),
    *(prior(SE2, convention, ("yaw", "x")) for convention in CONVENTIONS),
    *(prior(SE3, convention, ("z", "roll", "pitch")) for convention in CONVENTIONS),
    prior(SE3, "log", ("z",)),
    prior(R(3), "log", ("z", "x")),
    prior(R(2), "log", ("y",)),
    from_function("product-differences", (SE2, R(2)), 2, _product, None),
    from_function("product-jacobians", (SE2, R(2)), 2, _product, _product_jacobians),
    from_function("position-differences", (SE3,), 3, _position, None),
]
