"""Samples of the factors of an imaging sonar and of its vehicle's navigation, by hand as in `samples_sensors`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from factors import XYH, ZPR, Elevation, ElevationHinge, EpipolarArc, Factor, Noise, RangeAzimuth
from factors.keys import Keys
from models import SE3, Manifold, Measured, R
from tests.factors.samples import Sample, homogeneous
from tests.factors.samples_sensors import AHEAD, ASTERN, MOUNT, azimuth, elevation, in_sensor

Array = npt.NDArray[np.float64]
HERE = SE3.identity()[0]
TILTED = np.array([1.0, 2.0, 3.0, *Rotation.from_euler("ZYX", [-3.1, 0.4, -0.3]).as_quat()])


def hinge(limit: float) -> Callable[[Array], float]:
    """How far an elevation is beyond +-limit."""
    return lambda p: float(elevation(p) - np.clip(elevation(p), -limit, limit))


def bounded(limit: float) -> Callable[..., Factor]:
    """A hinge always measures 0; here it is made to measure z, for innovations as large as a case asks for."""

    def build(pose: Keys, target: Keys, z: Array, noise: Noise, offset: Array | Keys | None) -> Factor:
        factor = ElevationHinge(pose, target, limit, 1.0, offset)
        factor._z, factor._noise = z.copy(), noise
        factor._z.setflags(write=False)
        return factor

    return build


BY_HAND: dict[str, tuple[Callable[..., Factor], Manifold, Callable[[Array], object]]] = {
    "RangeAzimuth": (RangeAzimuth, Measured("range", "azimuth"), lambda p: [np.sqrt(p @ p), azimuth(p)]),
    "Elevation": (Elevation, Measured("elevation"), lambda p: [elevation(p)]),
    "ElevationHinge-outside": (bounded(0.1), Measured("elevation"), lambda p: [hinge(0.1)(p)]),
    "ElevationHinge-inside": (bounded(1.5), Measured("elevation"), lambda p: [hinge(1.5)(p)]),
}


def contact(name: str, mode: str, target: str = "point", where: str = "ahead") -> Sample:
    """mode: no offset, a fixed one, or a variable; target: point or pose; where it is."""
    kind, space, by_hand = BY_HAND[name]
    place = (AHEAD if where == "ahead" else ASTERN)[3]
    manifolds: tuple[Manifold, ...] = (SE3, R(3) if target == "point" else SE3)
    around = [HERE, place if target == "point" else np.concatenate([place, HERE[3:]])]
    if mode == "variable":
        manifolds, around = (*manifolds, SE3), [*around, HERE]

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        return kind(keys[0], keys[1], z, noise, {"none": None, "fixed": MOUNT[SE3], "variable": keys[-1]}[mode])

    def truth(X: Array, L: Array, *O: Array) -> Array:
        mounts = O[0] if O else np.tile(MOUNT[SE3] if mode == "fixed" else HERE, (len(X), 1))
        return np.array([by_hand(in_sensor(SE3, x, l, o)) for x, l, o in zip(X, L, mounts, strict=True)])

    full_name = f"{name}-{target}-{where}-offset {mode}"
    return Sample(full_name, manifolds, space, space.dim, build, truth, around=tuple(around))


def ypr(X: Array) -> Array:
    """Yaw, pitch and roll of one pose."""
    return np.asarray(Rotation.from_quat(X[3:]).as_euler("ZYX"))


def levelled(X_i: Array, X_j: Array) -> Array:
    """The step as complex numbers: along the heading of pose i."""
    out = []
    for a, b in zip(X_i, X_j, strict=True):
        step = (complex(*b[:2]) - complex(*a[:2])) * np.exp(-1j * ypr(a)[0])
        out.append([step.real, step.imag, np.angle(np.exp(1j * (ypr(b)[0] - ypr(a)[0])))])
    return np.array(out)


def relative(X_i: Array, X_j: Array) -> Array:
    out = []
    for a, b in zip(X_i, X_j, strict=True):
        back = Rotation.from_quat(a[3:]).inv()
        out.append([*back.apply(b[:3] - a[:3])[:2], (back * Rotation.from_quat(b[3:])).as_euler("ZYX")[0]])
    return np.array(out)


def xyh(form: str, name: str, around: Array) -> Sample:
    return Sample(
        f"XYH-{form}-{name}",
        (SE3, SE3),
        Measured("x", "y", "yaw"),
        3,
        lambda keys, z, noise: XYH(*keys, z, noise, form=form),
        levelled if form == "levelled" else relative,
        around=(around, around),
    )


def zpr(name: str, around: Array) -> Sample:
    return Sample(
        f"ZPR-{name}",
        (SE3,),
        Measured("z", "pitch", "roll"),
        3,
        lambda keys, z, noise: ZPR(keys[0], z, noise),
        lambda X: np.array([[x[2], *ypr(x)[1:]] for x in X]),
        around=(around,),
    )


def pair(mode: str, azimuth_i: float, name: str) -> Sample:
    """Two views of a point that is always at the same place in the first; mode: no offset, or a fixed one."""
    point = np.array([4.0, azimuth_i, 0.06])
    ca, sa, ce, se = np.cos(point[1]), np.sin(point[1]), np.cos(point[2]), np.sin(point[2])
    p = point[0] * np.array([ca * ce, sa * ce, se])
    mount = homogeneous(SE3, MOUNT[SE3] if mode == "fixed" else HERE)

    def truth(X_i: Array, X_j: Array) -> Array:
        out = []
        for a, b in zip(X_i, X_j, strict=True):
            l = homogeneous(SE3, a) @ mount @ [*p, 1.0]
            q = (np.linalg.inv(homogeneous(SE3, b) @ mount) @ l)[:3]
            out.append([*point[:2], np.sqrt(q @ q), azimuth(q)])
        return np.array(out)

    return Sample(
        f"EpipolarArc-{name}-offset {mode}",
        (SE3, SE3),
        Measured("range_i", "azimuth_i", "range_j", "azimuth_j"),
        4,
        lambda keys, z, noise: EpipolarArc(*keys, z, noise, 0.12, MOUNT[SE3] if mode == "fixed" else None),
        truth,
        around=(HERE, HERE),
    )


# What has eliminated unknowns depends on z: the predictions by hand above hold where there is no residual.
ELIMINATING_SAMPLES = [
    pair(mode, azimuth_i, name)
    for mode in ("none", "fixed")
    for azimuth_i, name in ((0.1, "ahead"), (np.pi - 1e-9, "astern"))
]

SONAR_SAMPLES = [
    *(contact(name, mode) for name in BY_HAND for mode in ("none", "fixed", "variable")),
    *(contact(name, mode, "pose") for name in BY_HAND for mode in ("none", "variable")),
    *(contact(name, "none", where="astern") for name in BY_HAND),
    *(
        xyh(form, name, around)
        for form in ("levelled", "relative")
        for name, around in (("level", HERE), ("tilted", TILTED))
    ),
    zpr("level", HERE),
    zpr("tilted", TILTED),
]
