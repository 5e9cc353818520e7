"""Samples of the factors of sensors, cameras and calibrations: by hand, through homogeneous matrices, one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

import factors as f
from factors import Bearing, BearingRange, DriftingStep, Factor, Landmark, Line, Noise, Range, Wheels
from factors.bundle import CAMERA, LENS
from factors.conventions import CONVENTIONS
from factors.keys import Keys
from models import LINE, S2, SE2, SE3, SO3, LieGroup, Manifold, Measured, R
from models.algebra import Array
from models.sensors import Camera
from tests.factors.samples import Sample, between, homogeneous, prior, stored

MOUNT = {  # a sensor ahead of and below the vehicle, tilted
    SE2: np.array([0.8, -0.3, 2.0]),
    SE3: np.array([0.8, -0.3, 0.4, *Rotation.from_euler("ZYX", [2.0, -0.6, 0.3]).as_quat()]),
}
AHEAD = {2: np.array([8.0, 4.0]), 3: np.array([8.0, 4.0, -5.0])}
ASTERN = {2: np.array([-9.0, 0.0]), 3: np.array([-9.0, 0.0, 2.0])}  # bearings near +-pi


def azimuth(p: Array) -> float:
    return float(np.angle(complex(p[0], p[1])))


def elevation(p: Array) -> float:
    return float(np.arcsin(p[2] / np.linalg.norm(p)))


def bearing_of(p: Array) -> list[float]:
    return [azimuth(p)] if len(p) == 2 else [azimuth(p), elevation(p)]


def in_frame(S: Array, target: Array) -> Array:
    """S^-1 l of one measurement; the target is a point, or the translation of a pose."""
    d = len(S) - 1
    return np.linalg.solve(S, np.append(target[:d], 1.0))[:d]


def mounted(
    name: str,
    kind: Callable[..., Factor],
    mode: str,
    space: Manifold,
    target: Manifold,
    by_hand: Callable[[Array, Array], object],
    around: tuple[Array, Array] | None,
    in_front: bool = False,
) -> Sample:
    """A sensor without an offset, with a fixed one, or with a variable: mode none, fixed or variable.

    by_hand : what the sensor in the frame S, a matrix, measures of a target.
    in_front : targets are moved to at least 3 m along the z axis of the sensor: z becomes |z| + 3.
    """
    group: LieGroup = SE2 if target in (R(2), SE2, LINE) else SE3
    variable, here = mode == "variable", group.identity()[0]

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        return kind(*keys[:2], z, noise, offset={"none": None, "fixed": MOUNT[group], "variable": keys[-1]}[mode])

    def frames(X: Array, *O: Array) -> list[Array]:
        mounts = O[0] if O else np.tile(MOUNT[group] if mode == "fixed" else here, (len(X), 1))
        return [homogeneous(group, x) @ homogeneous(group, o) for x, o in zip(X, mounts, strict=True)]

    def truth(X: Array, L: Array, *O: Array) -> Array:
        return np.array([by_hand(S, l) for S, l in zip(frames(X, *O), L, strict=True)])

    def visible(X: Array, L: Array, *O: Array) -> tuple[Array, ...]:
        L = L.copy()
        for k, S in enumerate(frames(X, *O)):
            p = in_frame(S, L[k])
            L[k, :3] = (S @ [p[0], p[1], abs(p[2]) + 3, 1.0])[:3]
        return X, L, *O

    manifolds = (group, target, *(group,) * variable)
    centers = None if around is None else (*around, *(here,) * variable)
    name = f"{name}-offset {mode}"
    return Sample(name, manifolds, space, space.dim, build, truth, "log", centers, visible if in_front else None)


def seen(
    kind: Callable[..., Factor],
    name: str,
    space: Manifold,
    by_hand: Callable[[Array], object],
    mode: str,
    target: Manifold,
    where: str = "ahead",
) -> Sample:
    """A sensor measures by_hand(p) of a point p in its frame; the target is a point or a pose."""
    group: LieGroup = SE2 if target in (R(2), SE2) else SE3
    d, here = group.point_dim, group.identity()[0]
    place = {"ahead": AHEAD, "astern": ASTERN}[where][d]
    place = place if target is R(d) else np.concatenate([place, here[d:]])
    name = f"{name}-{group}-{'point' if target is R(d) else 'pose'}-{where}"
    return mounted(name, kind, mode, space, target, lambda S, l: by_hand(in_frame(S, l)), (here, place))


def sighting(kind: type[Factor], group: LieGroup, mode: str, target: str = "point", where: str = "ahead") -> Sample:
    d = group.point_dim
    angles = ("bearing",) if d == 2 else ("azimuth", "elevation")
    by_hand, space = {
        Landmark: (lambda p: p, R(d)),
        Range: (lambda p: [np.sqrt(p @ p)], Measured("range")),
        Bearing: (bearing_of, Measured(*angles)),
        BearingRange: (lambda p: [*bearing_of(p), np.sqrt(p @ p)], Measured(*angles, "range")),
    }[kind]
    return seen(kind, kind.__name__, space, by_hand, mode, R(d) if target == "point" else group, where)


def sighting_from_point(kind: type[Factor], group: LieGroup) -> Sample:
    """The same from a point: from a pose with the axes of the world."""
    of_poses, d, level = sighting(kind, group, "none"), group.point_dim, group.identity()[0, group.point_dim :]
    return replace(
        of_poses,
        name=f"{kind.__name__}-from {R(d)}",
        manifolds=(R(d), R(d)),
        truth=lambda S, L: of_poses.truth(np.column_stack([S, np.tile(level, (len(S), 1))]), L),
        around=(np.zeros(d), AHEAD[d]),
    )


def position(group: LieGroup, components: tuple[str, ...] | None, arm: Array | None) -> Sample:
    names = components or ("x", "y", "z")[: group.point_dim]
    rows = ["xyz".index(name) for name in names]

    def truth(X: Array) -> Array:
        body = np.append(np.zeros(group.point_dim) if arm is None else arm, 1.0)
        return np.array([(homogeneous(group, x) @ body)[rows] for x in X])

    return Sample(
        f"Position-{group}-{'+'.join(names)}" + ("" if arm is None else "-arm"),
        (group,),
        Measured(*names),
        len(names),
        lambda keys, z, noise: f.Position(keys[0], z, noise, components, offset=arm),
        truth,
    )


def yaw_by_hand(group: Manifold, X: Array) -> Array:
    if group is SE2:
        return np.array([[np.angle(np.exp(1j * x[2]))] for x in X])
    return np.array([[Rotation.from_quat(x[3:]).as_euler("ZYX")[0]] for x in X])


def head(group: LieGroup, name: str, around: Array) -> Sample:
    return Sample(
        f"Heading-{group}-{name}",
        (group,),
        Measured("yaw"),
        1,
        lambda keys, z, noise: f.Heading(keys[0], z, noise),
        lambda X: yaw_by_hand(group, X),
        around=(around,),
    )


def gravity(group: LieGroup, down: tuple[float, ...]) -> Sample:
    g = np.array(down) / np.linalg.norm(down)
    return Sample(
        f"Gravity-{group}-down {down}",
        (group,),
        S2,
        2,
        lambda keys, z, noise: f.Gravity(keys[0], z, noise, down),
        lambda X: np.array([homogeneous(group, x)[:3, :3].T @ g for x in X]),
    )


def prior_at(group: LieGroup, convention: str, components: tuple[str, ...] | None = None) -> Sample:
    at_vehicle, mount = prior(group, convention, components), MOUNT[group]
    return replace(
        at_vehicle,
        name=f"{at_vehicle}-offset",
        build=lambda keys, z, noise: f.Prior(keys[0], z, noise, components, convention, offset=mount),
        truth=lambda X: np.array([stored(group, homogeneous(group, x) @ homogeneous(group, mount)) for x in X]),
    )


def between_sensors(group: LieGroup, convention: str, variable: bool) -> Sample:
    O_i = MOUNT.get(group, group.exp(np.full(group.dim, 0.4)))
    O_j = group.inverse(group.compose(O_i, O_i))

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        return f.BetweenSensors(keys[0], keys[1], z, noise, keys[2] if variable else (O_i, O_j), convention)

    def truth(X_i: Array, X_j: Array, *O: Array) -> Array:
        out = []
        for k in range(len(X_i)):
            a, b = (O[0][k], O[0][k]) if O else (O_i, O_j)
            S_i, S_j = (homogeneous(group, X[k]) @ homogeneous(group, o) for X, o in ((X_i, a), (X_j, b)))
            out.append(stored(group, np.linalg.inv(S_i) @ S_j))
        return np.array(out)

    return Sample(
        f"BetweenSensors-{group}-{convention}-offset {'variable' if variable else 'fixed'}",
        (group,) * (3 if variable else 2),
        group,
        group.dim,
        build,
        truth,
        convention,
    )


def pixels(camera: Array, intrinsics: Array, X: Array) -> Array:
    out = []
    for c, (focal, k1, k2), point in zip(camera, intrinsics, X, strict=True):
        P = Rotation.from_rotvec(c[:3]).apply(point) + c[3:]
        p = P[:2] / -P[2]
        out.append(focal * (1 + k1 * (p @ p) + k2 * (p @ p) ** 2) * p)
    return np.array(out)


BUNDLE = Sample(
    "BundleProjection",
    (CAMERA, LENS, R(3)),
    Measured("u", "v"),
    2,
    lambda keys, z, noise: f.BundleProjection(*keys, z, noise),
    pixels,
    around=(np.array([0.3, -0.2, 0.1, 0.5, 0.2, -15.0]), np.array([6.0, -0.1, 0.02]), np.array([1.0, -1.0, 0.5])),
)


def scaled_range(group: LieGroup, mode: str) -> Sample:
    unscaled = sighting(Range, group, mode)
    return replace(
        unscaled,
        name=f"ScaledRange-{group}-offset {mode}",
        manifolds=(*unscaled.manifolds, R(1)),
        build=lambda keys, z, noise: f.ScaledRange(*keys, z, noise, MOUNT[group] if mode == "fixed" else None),
        truth=lambda X, L, s: unscaled.truth(X, L) * (1 + s),
        around=(*(unscaled.around or ()), np.array([0.05])),
        visible=lambda X, L, s: (X, L, 0.1 * np.tanh(s)),
    )


BROWN = (-0.01, 0.002, 0.003, -0.002, 1e-5)  # k1 k2 p1 p2 k3
CAMERAS = {
    "normalized": Camera(),
    "pixels": Camera((5.0, 6.0), (3.0, 2.0)),
    "distorted": Camera((5.0, 6.0), (3.0, 2.0), BROWN),
}


def pixel(camera: Camera, p: Array) -> list[float]:
    """The image of one point, term by term as in the manual of OpenCV's calibration."""
    k1, k2, p1, p2, k3 = camera.distortion or (0.0,) * 5
    x, y = p[0] / p[2], p[1] / p[2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return [camera.focal[0] * u + camera.center[0], camera.focal[1] * v + camera.center[1]]


def image(name: str, mode: str, target: Manifold) -> Sample:
    camera = CAMERAS[name]

    def kind(pose: Keys, point: Keys, z: Array, noise: Noise, offset: Array | Keys | None) -> Factor:
        return f.Projection(pose, point, z, noise, camera, offset)

    name = f"Projection-{name}-{'pose' if target is SE3 else 'point'}"
    predict = lambda S, l: pixel(camera, in_frame(S, l))  # noqa: E731
    return mounted(name, kind, mode, Measured("u", "v"), target, predict, None, in_front=True)


def shifted(sample: Sample, k: int) -> Sample:
    """A sample with a calibration of k numbers, and rates that are the same for all measurements."""
    space = sample.space
    assert isinstance(space, LieGroup)
    G = np.random.default_rng(k).normal(0, 0.3, (space.dim, k))

    def truth(*X: Array) -> Array:
        h = np.asarray(sample.truth(*X[:-1]), dtype=float)
        return np.asarray(space.retract(h, (G @ X[-1][..., None])[..., 0]))

    return replace(
        sample,
        name=f"Shifted-{sample.name}-by {k}",
        manifolds=(*sample.manifolds, R(k)),
        build=lambda keys, z, noise: f.Shifted(sample.build(keys[:-1], z, noise), G, keys[-1]),
        truth=truth,
        around=None if sample.around is None else (*sample.around, np.zeros(k)),
    )


KINDS: list[type[Factor]] = [Landmark, Range, Bearing, BearingRange]
PLANE_AND_SPACE: list[LieGroup] = [SE2, SE3]
TILTED = np.array([1.0, 2.0, 3.0, *Rotation.from_euler("ZYX", [-3.1, 0.2, -0.3]).as_quat()])

SENSOR_SAMPLES = [
    *(sighting(*choice) for choice in product(KINDS, PLANE_AND_SPACE, ("none", "fixed", "variable"))),
    *(sighting(*choice, "pose") for choice in product(KINDS, PLANE_AND_SPACE, ("none", "variable"))),
    *(sighting(kind, group, "none", where="astern") for kind in (Bearing, BearingRange) for group in PLANE_AND_SPACE),
    *(sighting_from_point(kind, group) for kind in (Range, Bearing) for group in PLANE_AND_SPACE),
    position(SE2, None, None),
    position(SE2, ("y",), np.array([1.5, -0.5])),
    position(SE3, None, None),
    position(SE3, ("z",), None),
    position(SE3, None, np.array([0.5, -0.2, 1.0])),
    position(SE3, ("z", "x"), np.array([0.5, -0.2, 1.0])),
    *(scaled_range(group, mode) for group in PLANE_AND_SPACE for mode in ("none", "fixed")),
    head(SE2, "level", np.array([1.0, 2.0, -3.0])),
    head(SE3, "level", SE3.identity()[0]),
    head(SE3, "tilted", TILTED),
    *(gravity(group, down) for group in (SE3, SO3) for down in ((0, 0, 1), (0, 0, -2), (0.3, -0.5, 0.2))),
    *(prior_at(group, convention) for group in PLANE_AND_SPACE for convention in CONVENTIONS),
    prior_at(SE3, "g2o", ("z", "roll")),
    *(between_sensors(g, c, v) for g in PLANE_AND_SPACE for c in CONVENTIONS for v in (False, True)),
    *(between_sensors(SO3, "log", variable) for variable in (False, True)),
    between_sensors(R(2), "log", False),
    BUNDLE,
    *(image(name, mode, R(3)) for name in CAMERAS for mode in ("none", "fixed", "variable")),
    *(image("distorted", mode, SE3) for mode in ("none", "variable")),
    shifted(head(SE3, "tilted", TILTED), 1),
    shifted(shifted(head(SE2, "level", np.array([1.0, 2.0, -3.0])), 1), 2),
    shifted(position(SE3, ("z", "x"), MOUNT[SE3][:3]), 2),
    shifted(prior(SE2, "log", ("yaw", "x")), 1),
    *(shifted(sample, 2) for sample in (between(SE2, "log"), between(SE3, "log"), sighting_from_point(Bearing, SE2))),
]


def line_in_sensor(S: Array, l: Array) -> list[float]:
    """The line through two points of it, both taken to the frame S (3, 3); its normal turns as the axes do."""
    n = np.exp(1j * l[0])
    p, q = (np.linalg.solve(S, [v.real, v.imag, 1.0]) for v in (l[1] * n, l[1] * n + 1j * n))
    along = complex(*(q - p)[:2]) / abs(complex(*(q - p)[:2]))
    normal = -1j * along
    return [float(np.angle(normal)), float((np.conj(normal) * complex(*p[:2])).real)]


def travelled(base: float, X_i: Array, X_j: Array) -> Array:
    """By the turn and the way, seen from the middle of the turn."""
    out = []
    for a, b in zip(X_i, X_j, strict=True):
        turn = np.angle(np.exp(1j * (b[2] - a[2])))
        way = complex(*(b - a)[:2]) * np.exp(-1j * (a[2] + turn / 2))
        out.append([way.real + turn * base / 2, way.real - turn * base / 2, way.imag])
    return np.array(out)


def wheels(name: str, base: float, turned: float) -> Sample:
    return Sample(
        f"Wheels-{name}",
        (SE2, SE2),
        Measured("right", "left", "lateral"),
        3,
        lambda keys, z, noise: Wheels(*keys, z, noise, base),
        lambda X_i, X_j: travelled(base, X_i, X_j),
        around=(np.array([1.0, -2.0, 3.0]), np.array([2.0, -1.5, turned])),
    )


def reckoned(length: float, X_i: Array, X_j: Array, d: Array) -> Array:
    """The step as it was, and the drift for every meter of it."""
    out = []
    for a, b, drift in zip(X_i, X_j, d, strict=True):
        way = complex(*(b - a)[:2]) * np.exp(-1j * a[2]) + length * complex(*drift)
        out.append([way.real, way.imag, np.angle(np.exp(1j * (b[2] - a[2])))])
    return np.array(out)


def drifting(name: str, length: float, turned: float) -> Sample:
    return Sample(
        f"DriftingStep-{name}",
        (SE2, SE2, R(2)),
        Measured("x", "y", "yaw"),
        3,
        lambda keys, z, noise: DriftingStep(*keys, z, noise, np.full(len(z), length)),
        lambda X_i, X_j, d: reckoned(length, X_i, X_j, d),
        around=(np.array([1.0, -2.0, 3.0]), np.array([2.0, -1.5, turned]), np.array([0.1, -0.2])),
    )


PLANE_SAMPLES = [
    *(
        mounted(f"Line-{name}", Line, mode, LINE, LINE, line_in_sensor, (np.array(pose), np.array(wall)))
        for name, mode, pose, wall in (
            *(("wall ahead", mode, [0.0, 0.0, 0.0], [0.2, 8.0]) for mode in ("none", "fixed", "variable")),
            ("at pi", "none", [2.0, 1.0, -3.0], [-3.1, 0.5]),
            ("behind the origin", "none", [2.0, 1.0, 0.5], [1.0, -4.0]),
        )
    ),
    wheels("ahead", 0.5, 3.1),
    wheels("over pi", 1.2, -2.9),
    drifting("ahead", 1.5, 3.1),
    drifting("over pi", 0.7, -2.9),
    drifting("standing", 0.0, 3.0),
]
