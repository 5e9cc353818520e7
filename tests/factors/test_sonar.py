"""What is done about the elevation that a sonar does not measure: factors of a hinge, a prior, a search."""

from __future__ import annotations

from math import radians, sqrt

import numpy as np
import pytest

import factors as f
from factors import Elevation, ElevationHinge, EpipolarArc, Huber, Isotropic, sonar_factors
from models import SE3, R, euler
from models.errors import GraphError, OptionError
from models.sensors import DIDSON_HIGH, cartesian
from nls import FactorGraph, Values, kinds
from tests.factors.evaluated import linearized, refused, same

x, l, o = kinds("x", "l", "o")
UNIT = Isotropic()
LIMIT = DIDSON_HIGH.aperture / 2
MOUNTED = euler.to_se3(np.array([0.0, -0.6, 0.0, 0.3, 0.0, 0.1]))


def test_treatments_of_the_elevation() -> None:
    pose, target, z = x[[3, 1, 2]], l[[8, 8, 5]], [[5.0, 0.1], [4.0, 0.2], [3.0, -0.1]]

    def made(**more: object) -> list[f.Factor]:
        return sonar_factors(pose, target, z, None, DIDSON_HIGH, offset=SE3.identity()[0], **more)

    (contacts,) = made(elevation="free")
    same(contacts.noise.sqrt_information(3, ("range", "azimuth")), 1 / DIDSON_HIGH.noise_sigmas[None])
    hinge = made(softness=0.05)[1]
    assert isinstance(hinge, ElevationHinge)
    assert (hinge.limit, hinge.keys, hinge.noise.sigma) == (LIMIT, contacts.keys, 0.05)
    prior = made(elevation="prior")[1]
    assert type(prior) is Elevation
    assert prior.keys == (x[[2, 1]], l[[5, 8]]), "of the first contact of each landmark"
    same(prior.noise.sigma, radians(14) / sqrt(12))
    for factor in (contacts, hinge, prior):
        assert np.array_equal(factor.offset, SE3.identity())
    with pytest.raises(OptionError, match=r"elevation: 'bounded' .* free, hinge, prior or search"):
        made(elevation="bounded")


def test_the_search_pairs_the_first_contact_of_every_target_with_its_later_ones() -> None:
    """Targets 8, 5 and 6 from poses in any order; 6 is seen once."""
    pose, target = x[[3, 1, 2, 4, 7, 2]], l[[8, 8, 5, 6, 8, 8]]
    z = np.array([[5.0, 0.1], [4.0, 0.2], [3.0, -0.1], [6.0, 0.0], [5.5, 0.05], [4.5, 0.15]])
    sigmas = np.arange(1.0, 13.0).reshape(6, 2) / 100

    def made(noise: f.Noise | None = None, offset: object = None) -> EpipolarArc:
        (factor,) = sonar_factors(pose, target, z, noise, DIDSON_HIGH, offset, elevation="search")
        assert isinstance(factor, EpipolarArc)
        return factor

    arcs = made(f.Diagonal(sigmas), MOUNTED)
    assert arcs.keys == (x[[1, 1, 1]], x[[3, 7, 2]])
    same(arcs.z, np.hstack([z[[1, 1, 1]], z[[0, 4, 5]]]))
    W = arcs.noise.sqrt_information(3, EpipolarArc.measures)
    same(W, np.eye(4) / np.hstack([np.sqrt(3) * sigmas[[1, 1, 1]], sigmas[[0, 4, 5]]])[:, None])  # divided by 3 pairs
    assert arcs.limit == LIMIT
    same(arcs.offset, MOUNTED[None])
    same(
        made().noise.sqrt_information(3, EpipolarArc.measures)[-1],
        np.diag(1 / np.tile(DIDSON_HIGH.noise_sigmas, 2) / np.sqrt([3, 3, 1, 1])),
    )
    assert made(f.Robust(Isotropic(0.1), Huber(2.0))).kernel == Huber(2.0)
    each = np.tile(MOUNTED, (6, 1))
    same(made(offset=each).offset, each[:3])
    each[4] = SE3.identity()[0]
    two, three = [[4, 0.1], [4, 0.2]], [1, 2, 3]
    for make, named in (
        (lambda: made(offset=each), r"RangeAzimuth\(x\[1, 7\], l\[8, 8\]\): two offsets"),
        (lambda: made(offset=o[0]), "the offset o0 is a variable"),
        (lambda: sonar_factors(x[[0, 1]], l[0], three, None, DIDSON_HIGH, elevation="search"), r"RangeAz.* \(3,\)"),
        (lambda: sonar_factors(x[[2, 2]], l[0], two, None, DIDSON_HIGH, elevation="search"), "x2 to itself"),
    ):
        refused(make, GraphError, named)
    (none,) = sonar_factors(x[0:3], l[0:3], z[:3], None, DIDSON_HIGH, elevation="search")
    assert len(none) == 0
    graph = FactorGraph([none, f.Prior(x[0], SE3.identity()[0], UNIT)])
    assert graph.optimize(Values({x: (SE3, SE3.identity())})).dof == 0


def test_a_hinge_pushes_until_the_target_is_inside_again() -> None:
    """Beyond by d, one measurement of sigma s: chi2 is (d / s)^2, and its derivative is that of the elevation."""
    factor = ElevationHinge(x[[0, 0, 0, 0]], l[0:4], LIMIT, softness=radians(1))
    el = np.array([LIMIT + radians(2), -LIMIT - radians(3), LIMIT - 1e-9, -LIMIT / 2])
    values = Values({x: (SE3, SE3.identity()), l: (R(3), cartesian(np.stack([[4.0] * 4, [0.1] * 4, el], axis=1))[0])})
    same(factor.chi2(values), [4.0, 9.0, 0.0, 0.0], atol=1e-12)
    A, b = linearized(factor, values)
    assert (b[0] < 0).all()  # back, towards 0
    assert (b[1] > 0).all()
    known = Elevation(x[[0, 0, 0, 0]], l[0:4], 0.0, Isotropic(radians(1)))
    for A_k, of_elevation in zip(A, linearized(known, values)[0], strict=True):
        same(A_k[:2], of_elevation[:2], atol=1e-12)
        same(A_k[2:], 0.0)
    assert factor.damped
