"""XYH, ZPR, RangeAzimuth and what is done about the elevation: what is refused, what is free, what is biased."""

from __future__ import annotations

from collections.abc import Callable
from math import pi, radians, sqrt

import numpy as np
import numpy.typing as npt
import pytest

from factors import (
    XYH,
    ZPR,
    Diagonal,
    Elevation,
    ElevationHinge,
    EpipolarArc,
    Factor,
    Heading,
    Huber,
    Isotropic,
    Noise,
    Position,
    Prior,
    RangeAzimuth,
    Robust,
    sonar_factors,
)
from factors.keys import Keys
from models import SE2, SE3, R, euler
from models.errors import GraphError, NoiseModelError, OptionError, SingularGeometryError, UnderconstrainedError
from models.sensors import DIDSON_HIGH, cartesian, range_azimuth, spherical
from nls import FactorGraph, GaussNewton, Marginals, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import linearized, refused, same

Array = npt.NDArray[np.float64]
x, l, o = kinds("x", "l", "o")
UNIT = Isotropic()
LIMIT = DIDSON_HIGH.aperture / 2
MOUNTED = euler.to_se3(np.array([0.0, -0.6, 0.0, 0.3, 0.0, 0.1]))


def poses(*e: list[float]) -> Array:
    """Of Euler vectors (roll, pitch, yaw, x, y, z)."""
    return euler.to_se3(np.array(e, dtype=float))


def contacts_of(X: Array, L: Array) -> Array:
    """(r, az, el) (n, k, 3) of points L (k, 3) at poses X (n, 7)."""
    return np.array([spherical(SE3.act(SE3.inverse(X[[i]]), L))[0] for i in range(len(X))])


@for_all(
    case=[
        (lambda: XYH(x[0], x[1], [1, 2], UNIT), GraphError, r"XYH\(x0, x1\): .*\(2,\)"),
        (lambda: ZPR(x[0], [1, 2, 3, 4], UNIT), GraphError, r"ZPR\(x0\): .*\(4,\)"),
        (lambda: XYH(x[0], x[1], [1, 2, 3], UNIT, form="tilted"), OptionError, "'tilted' .*levelled or"),
        (lambda: ZPR(x[0], [1, 2, 3], Diagonal(x=1, pitch=1, roll=1)), NoiseModelError, r"\['z', 'pitch', 'roll'\]"),
        (lambda: XYH(x[0], x[1], [1, 2, 3], Diagonal(x=1, y=1, z=1)), NoiseModelError, r"\['x', 'y', 'yaw'\]"),
        (lambda: RangeAzimuth(x[0], l[0], [1, 2], Diagonal(bearing=1, range=1)), NoiseModelError, "'range', 'azimuth'"),
        (lambda: RangeAzimuth(x[0], l[0], [1, 2, 3], UNIT), GraphError, r"RangeAzimuth\(x0, l0\): .*\(3,\)"),
        (lambda: ElevationHinge(x[0], l[0], 7.0), OptionError, r"limit: 7.0 .*\(0, pi / 2\), rad"),
        (lambda: ElevationHinge(x[0], l[0], "a"), OptionError, "limit: 'a'"),
        (lambda: ElevationHinge(x[0], l[0], np.array([0.1, 0.2])), OptionError, "limit: array"),
        (lambda: XYH(x[0], x[1], [1, 2, 3], UNIT, form=["levelled"]), OptionError, "form: "),
        (lambda: ElevationHinge(x[0], l[0], 0.1, softness=0.0), OptionError, "ElevationHinge: softness: 0.0"),
        (lambda: RangeAzimuth(o[0], l[0], [1.0, 0.0], UNIT), GraphError, "RangeAzimuth: o0 is in SE2, .* SE3"),
        (lambda: Elevation(o[0], l[0], 1.0, UNIT), GraphError, "Elevation: o0 is in SE2, .* SE3"),
        (lambda: RangeAzimuth(x[0], o[0], [1.0, 0.0], UNIT), GraphError, r"o0 is in SE2; .* R\(3\) or SE3"),
        (lambda: Elevation(x[0], o[0], 1.0, UNIT), GraphError, r"o0 is in SE2; .* R\(3\) or SE3"),
    ]
)
def test_what_does_not_fit(case: tuple[Callable[[], Factor], type[Exception], str]) -> None:
    make, kind, named = case
    values = Values({x: (SE3, SE3.identity(2)), l: (R(3), [5, 0, 0]), o: (SE2, [0, 0, 0])})
    refused(lambda: values.gather(make()), kind, named)


def test_singular_geometry_names_the_measurement() -> None:
    """Pose x1 looks straight up, target l1 is straight below."""
    X = poses([0] * 6, [0, pi / 2, 0, 0, 0, 0], [0] * 6, [0] * 6)
    values = Values({x: (SE3, X), l: (R(3), [[5, 0, 0], [0, 0, 3]])})
    for factor in (
        XYH(x[[0, 1]], x[[2, 3]], [0, 0, 0], UNIT),
        ZPR(x[[0, 1]], [0, 0, 0], UNIT),
        RangeAzimuth(x[[0, 2]], l[[0, 1]], [1, 0], UNIT),
        Elevation(x[[0, 2]], l[[0, 1]], 0.0, UNIT),
        ElevationHinge(x[[0, 2]], l[[0, 1]], 0.1),
    ):
        keys = ", ".join(repr(k[[1]]) for k in factor.keys)
        named = rf"{factor.name}\({keys}\): .*(gimbal|target is on)"
        refused(lambda factor=factor: linearized(factor, values), SingularGeometryError, named)


def lawn(n: int = 8) -> tuple[Values, list[Factor]]:
    """A vehicle that turns, dives and tilts on its way; exact navigation."""
    t = np.arange(n)
    e = np.stack([0.1 * np.sin(t), 0.1 * np.cos(2 * t), 0.7 * t, t, np.sin(t), 5 + 0.3 * np.cos(t)], axis=1)
    step = SE2.between(e[:-1][:, [3, 4, 2]], e[1:][:, [3, 4, 2]])
    odometry = XYH(x[0 : n - 1], x[1:n], step, Diagonal(x=0.01, y=0.01, yaw=0.004))
    tilt = ZPR(x[0:n], e[:, [5, 1, 0]], Diagonal(z=0.01, pitch=0.002, roll=0.002))
    return Values({x: (SE3, euler.to_se3(e))}), [odometry, tilt]


def test_navigation_leaves_x_y_and_heading_free() -> None:
    """Three directions, of the whole path; two of a position and a heading in the world hold them, exactly."""
    truth, navigation = lawn()
    start = truth.retract(np.random.default_rng(1).normal(scale=0.05, size=truth.dim))
    with pytest.raises(UnderconstrainedError) as caught:
        FactorGraph(navigation).optimize(start)
    assert caught.value.nullity == 3
    here = Position(x[0], truth[x[0]][:2], Isotropic(1e-3), components=("x", "y"))
    north = Heading(x[0], 0.0, Isotropic(1e-4))
    result = FactorGraph([*navigation, here, north]).optimize(start)
    assert result.converged
    assert result.chi2_final < 1e-12
    same(SE3.local(truth[x], result.values[x]), 0.0, atol=1e-6)


def test_the_relative_form_has_a_gauge_and_the_levelled_one_none() -> None:
    assert XYH(x[0], x[1], [0, 0, 0], UNIT, form="relative").relative
    assert not XYH(x[0], x[1], [0, 0, 0], UNIT).relative


def test_treatments_of_the_elevation() -> None:
    pose, target, z = x[[3, 1, 2]], l[[8, 8, 5]], [[5.0, 0.1], [4.0, 0.2], [3.0, -0.1]]

    def made(**more: object) -> list[Factor]:
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

    def made(noise: Noise | None = None, offset: object = None) -> EpipolarArc:
        (factor,) = sonar_factors(pose, target, z, noise, DIDSON_HIGH, offset, elevation="search")
        assert isinstance(factor, EpipolarArc)
        return factor

    arcs = made(Diagonal(sigmas), MOUNTED)
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
    assert made(Robust(Isotropic(0.1), Huber(2.0))).kernel == Huber(2.0)
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
    graph = FactorGraph([none, Prior(x[0], SE3.identity()[0], UNIT)])
    assert graph.optimize(Values({x: (SE3, SE3.identity())})).dof == 0


@for_all(elevation=["free", "hinge", "prior"])
def test_the_mounting_may_be_a_variable(elevation: str) -> None:
    truth, navigation = lawn(12)
    mount, rng = poses([0.05, -0.6, 0.1, 0.3, 0.05, 0.1]), np.random.default_rng(2)
    S = SE3.compose(truth[x], mount)
    L = SE3.position(S)[5] + rng.uniform(-4, 4, size=(30, 3))
    z = contacts_of(S, L)
    seen = (np.abs(z[..., 2]) < 1.2) & (z[..., 0] < 5)
    often = seen.sum(axis=0) >= 3
    L, z, (i, k) = L[often], z[:, often], np.nonzero(seen[:, often])
    assert len(L) > 15
    sonar = sonar_factors(x[i], l[k], z[i, k, :2], Diagonal(range=0.01, azimuth=0.004), DIDSON_HIGH, o[0], elevation)
    noise_free = sonar if elevation == "free" else [sonar[0]]
    start = Values({x: (SE3, truth[x]), l: (R(3), L + rng.normal(scale=0.05, size=L.shape)), o: (SE3, SE3.identity())})
    start[o[0]] = SE3.retract(mount, np.full((1, 6), 0.03))[0]
    graph = FactorGraph([*navigation, *noise_free])
    graph.fix(x[0])
    result = graph.optimize(start)
    assert result.converged
    same(SE3.local(mount, result.values[o[[0]]]), 0.0, atol=1e-6)
    for factor in sonar:
        assert factor.keys[2] == Keys("o", np.zeros(len(factor), dtype=int))


def heaving() -> tuple[Array, Array, Array]:
    """A vehicle that heaves, rolls and steps sideways by little; points in its aperture at every view."""
    X = poses([0, 0, 0, 0, 0, 0], [0.1, 0, 0, 0, 0.1, 0.05], [0, 0.01, 0, 0.05, 0, -0.05], [-0.1, 0, 0.1, 0, 0.1, 0.05])
    h = np.random.default_rng(3).uniform([3.0, -0.2, -0.06], [5.0, 0.2, 0.06], size=(40, 3))
    L = cartesian(h)[0]
    z = contacts_of(X, L)
    assert np.abs(z[..., 2]).max() < LIMIT
    return X, L, z


def test_contacts_and_a_hinge_find_the_elevation() -> None:
    X, L, z = heaving()
    i, k = (a.ravel() for a in np.meshgrid(np.arange(4), np.arange(40), indexing="ij"))
    factors = sonar_factors(x[i], l[k], z[i, k, :2], None, DIDSON_HIGH)
    graph = FactorGraph(factors)
    graph.fix(x[0:4])
    start = Values({x: (SE3, X), l: (R(3), cartesian(z[0] * [1, 1, 0])[0])})
    result = graph.optimize(start)
    assert result.method == "levenberg-marquardt", "a hinge asks for damping"
    assert result.converged
    same(result.values[l], L, atol=1e-5)
    inside = FactorGraph([factors[0]])
    inside.fix(x[0:4])
    assert inside.optimize(start).method == "gauss-newton"
    for key in (l[0], l[7]):  # all elevations are inside: the hinge adds no information
        same(
            Marginals(graph, result.values).covariance(key), Marginals(inside, result.values).covariance(key), rtol=1e-5
        )


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


def test_limits_are_no_degrees_of_freedom() -> None:
    X = poses([0, 0, 0, 0, 0, 0], [0.2, 0, 0, 0, 0, 0.5], [0, 0, 0, 0, 0, 1.0])
    z = contacts_of(X, cartesian(np.array([[4.0, 0.1, 0.02]]))[0])[:, 0, :2]
    for elevation, dof in (("free", 6 - 3), ("hinge", 6 - 3), ("prior", 6 + 1 - 3)):
        graph = FactorGraph(sonar_factors(x[0:3], l[0], z, None, DIDSON_HIGH, elevation=elevation))
        graph.fix(x[0:3])
        assert graph.optimize(Values({x: (SE3, X), l: (R(3), [4.0, 0.4, 0.1])})).dof == dof


def test_planar_motion_at_elevation_zero_leaves_one_direction_for_each_landmark() -> None:
    """Gauss-Newton refuses and names every landmark; with some heave none is free."""
    rng, k = np.random.default_rng(4), 5
    L = cartesian(rng.uniform([3.0, -0.2, 0.0], [5.0, 0.2, 0.0], size=(k, 3)))[0]
    for heave in (0.0, 0.3):
        X = poses([0, 0, 0, 0, 0, 0], [0, 0, 0.1, 0.3, 0.2, heave], [0, 0, -0.1, 0.1, -0.2, -heave])
        z = contacts_of(X, L)
        i, j = (a.ravel() for a in np.meshgrid(np.arange(3), np.arange(k), indexing="ij"))
        graph = FactorGraph(sonar_factors(x[i], l[j], z[i, j, :2], None, DIDSON_HIGH, elevation="free"))
        graph.fix(x[0:3])
        values = Values({x: (SE3, X), l: (R(3), L)})
        if heave:
            assert graph.optimize(values, GaussNewton()).converged
            continue
        with pytest.raises(UnderconstrainedError) as caught:
            graph.optimize(values, GaussNewton())
        assert caught.value.nullity == k
        assert {int(key.numbers[0]) for key in caught.value.keys} == set(range(k))
        assert {key.kind for key in caught.value.keys} == {"l"}


def test_a_prior_at_first_sight_is_biased_and_a_hinge_is_not() -> None:
    """A vehicle that moves ahead sees each target first at one end of the aperture, here at 6 of 7 deg: the prior pulls
    all of them the same way."""
    rng, k, n = np.random.default_rng(5), 400, 4
    X = poses(*[[0.0, 0.0, 0.0, 0.02 * t, 0.0, 0.03 * t] for t in range(n)])
    L = cartesian(np.column_stack([rng.uniform(3, 5, k), rng.uniform(-0.2, 0.2, k), np.full(k, radians(6))]))[0]
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(k), indexing="ij"))
    sigmas = np.array([2e-3, 2e-3])
    z = contacts_of(X, L)[i, j, :2] + rng.normal(size=(n * k, 2)) * sigmas
    bias = {}
    for elevation in ("free", "hinge", "prior"):
        graph = FactorGraph(sonar_factors(x[i], l[j], z, Diagonal(sigmas), DIDSON_HIGH, elevation=elevation))
        graph.fix(x[0:n])
        result = graph.optimize(Values({x: (SE3, X), l: (R(3), L)}))
        assert result.converged
        el = spherical(result.values[l])[0][:, 2]
        bias[elevation] = np.rad2deg(el.mean()) - 6.0, np.rad2deg(el.std()) / sqrt(k)
    assert abs(bias["free"][0]) < 4 * bias["free"][1]
    assert bias["prior"][0] < -10 * bias["prior"][1]
    assert bias["prior"][0] == pytest.approx(-1.0, abs=0.2)
    assert bias["hinge"][0] == pytest.approx(-0.26, abs=0.2)


def test_targets_seen_once_are_free_within_the_hinge_and_the_rest_is_solved() -> None:
    """Fewer measurements than unknowns, which is no mistake where limits hold what is free."""
    n = 3
    z = np.stack([np.linspace(3.0, 5.0, n), np.linspace(-0.2, 0.2, n)], axis=1)
    graph = FactorGraph(sonar_factors(x[[0] * n], l[0:n], z, None, DIDSON_HIGH))
    graph.fix(x[0])
    near = cartesian(np.column_stack([z + 0.1, np.full(n, 0.05)]))[0]
    result = graph.optimize(Values({x: (SE3, SE3.identity()), l: (R(3), near)}))
    assert result.converged
    assert len(result.underconstrained) == n
    assert result.dof == 0
    assert "free: 3 directions" in result.reason
    same(range_azimuth(result.values[l])[0], z, atol=1e-6)
