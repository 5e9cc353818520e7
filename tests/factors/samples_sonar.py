"""Samples of the factors of an imaging sonar and of its vehicle's navigation, by hand as in `samples_sensors`."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from factors import XYH, ZPR, DvlLeg, Elevation, ElevationHinge, EpipolarArc, Factor, Noise, RangeAzimuth
from factors.keys import Keys
from models import SE3, Manifold, Measured, R
from models.algebra import Array
from tests.factors.samples import Sample, homogeneous
from tests.factors.samples_sensors import MOUNT, TILTED, azimuth, elevation, seen

HERE = SE3.identity()[0]


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


CONTACTS: dict[str, tuple[Callable[..., Factor], Manifold, Callable[[Array], object]]] = {
    "RangeAzimuth": (RangeAzimuth, Measured("range", "azimuth"), lambda p: [np.sqrt(p @ p), azimuth(p)]),
    "Elevation": (Elevation, Measured("elevation"), lambda p: [elevation(p)]),
    "ElevationHinge-outside": (bounded(0.1), Measured("elevation"), lambda p: [hinge(0.1)(p)]),
    "ElevationHinge-inside": (bounded(1.5), Measured("elevation"), lambda p: [hinge(1.5)(p)]),
}


def contact(name: str, mode: str, target: Manifold, where: str = "ahead") -> Sample:
    kind, space, by_hand = CONTACTS[name]
    return seen(kind, name, space, by_hand, mode, target, where)


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


def dvl_leg(mode: str) -> Sample:
    """A leg with a scale, an angle or both as variables; p, q and u are parts of it as in a tilted vehicle."""
    ways, at = np.array([[3.0, 0.4], [-0.5, 2.9], [0.2, -0.1]]), (0.05, -0.1)
    names = [name for name in ("scale", "yaw") if name in mode]

    def by(s: float, a: float) -> complex:
        p, q, u = (complex(*way) for way in ways)
        return (1 + at[0]) / (1 + s) * (p * np.cos(a - at[1]) + q * np.sin(a - at[1]) + u)

    def truth(X_i: Array, X_j: Array, *c: Array) -> Array:
        h = levelled(X_i, X_j)
        for k in range(len(h)):
            given = dict(zip(names, (float(x[k, 0]) for x in c), strict=True))
            more = by(*at) - by(given.get("scale", at[0]), given.get("yaw", at[1]))
            h[k, :2] += [more.real, more.imag]
        return h

    return Sample(
        f"DvlLeg-{mode}",
        (SE3, SE3, *[R(1)] * len(names)),
        Measured("x", "y", "yaw"),
        3,
        lambda keys, z, noise: DvlLeg(
            *keys[:2], z, noise, np.tile(ways, (len(z), 1, 1)), **dict(zip(names, keys[2:], strict=True)), at=at
        ),
        truth,
        around=(TILTED, TILTED, *[np.array([4.0])] * len(names)),
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
    pair(mode, *place) for mode, place in product(("none", "fixed"), ((0.1, "ahead"), (np.pi - 1e-9, "astern")))
]

SONAR_SAMPLES = [
    *(contact(name, mode, R(3)) for name in CONTACTS for mode in ("none", "fixed", "variable")),
    *(contact(name, mode, SE3) for name in CONTACTS for mode in ("none", "variable")),
    *(contact(name, "none", R(3), "astern") for name in CONTACTS),
    *(xyh(form, *place) for form, place in product(("levelled", "relative"), (("level", HERE), ("tilted", TILTED)))),
    *(dvl_leg(mode) for mode in ("scale", "yaw", "scale and yaw")),
    zpr("level", HERE),
    zpr("tilted", TILTED),
]
