"""Elevations: what a second view tells about one, landmarks that may be mirrored, the edge of the aperture."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import nls.sonar
import sim
from factors import Covariance, Diagonal, ElevationHinge, Isotropic, Prior, RangeAzimuth
from models import SE3, R
from models.algebra import Array, Mask
from models.errors import GraphError, OptionError
from models.sensors import DIDSON_HIGH, cartesian, elevation, spherical
from nls import FactorGraph, LevenbergMarquardt, Marginals, SingularGeometryError, Values, kinds
from nls.missions import elevations
from nls.missions.pictures.elevation_map import elevation_map, motions
from nls.missions.sonar import elevation_sigma
from nls.missions.sonar.elevation import mirrored
from nls.plot.picture import write_picture
from tests.combinations import for_all

x, l = kinds("x", "l")
SIGMAS = np.array([0.01, np.radians(0.25)])
SONAR = replace(DIDSON_HIGH, window=(1.0, 6.0), quality=2.0)
POINTS = np.array([[4.0, 0.1, 0.05], [3.0, -0.2, -0.1], [5.5, 0.0, 0.0], [2.0, 0.24, 0.12]])


@for_all(motion=[[0.1, -0.2, 0.4, 0.2, 0.1, -0.1], [0.3, 0.1, 0.0, 0.1, 0.0, 0.2]], known=[True, False])
def test_it_is_the_marginal_of_the_graph_of_two_views(motion: list[float], known: bool) -> None:
    G, Sigma = SE3.exp(np.array(motion)), np.diag(np.array([0.02, 0.03, 0.01, 0.003, 0.002, 0.01]) ** 2)
    Sigma[0, 1] = Sigma[1, 0] = 3e-4
    found = elevation_sigma(G, POINTS, SIGMAS, None if known else Sigma)
    for h, sigma in zip(POINTS, found, strict=True):
        p, _ = cartesian(h[None])
        values = Values({x: (SE3, np.stack([SE3.identity()[0], G])), l: (R(3), p)})
        graph = FactorGraph([RangeAzimuth(x[[0, 1]], l[0], [h[:2], h[:2]], Diagonal(SIGMAS))])
        graph.fix(x[[0, 1]] if known else x[0])
        if not known:
            graph.add(Prior(x[1], G, Covariance(Sigma)))
        J = elevation(p)[1][0]
        assert sigma == pytest.approx(np.sqrt((J @ Marginals(graph, values).covariance(l[0]) @ J.T).item()), rel=1e-6)


def test_the_table_of_motions() -> None:
    """Yaw never; surge, sway and planar motion not at elevation 0; pitch not straight ahead; heave and roll do."""
    ahead, below, aside = np.array([[4.0, 0.0, 0.0], [4.0, 0.0, 0.1], [4.0, 0.2, 0.0]])
    flown = {name.split()[0]: G for name, G in motions(0.3, 0.2).items()}
    sigma = {name: np.degrees(elevation_sigma(G, [ahead, below, aside], SIGMAS)) for name, G in flown.items()}
    assert (sigma["yaw"] > 1e6).all()
    for name in ("surge", "sway"):
        assert sigma[name][0] == np.inf > sigma[name][1] > 1
    assert sigma["pitch"][0] == np.inf > 30 > sigma["pitch"][2]
    assert max(*sigma["heave"], *sigma["roll"]) < 3
    planar = elevation_sigma(SE3.exp([0.3, 0.2, 0, 0, 0, 0.3]), [ahead, aside], SIGMAS)
    assert (planar > 1e6).all()


def test_half_the_sigmas_or_an_uncertain_motion() -> None:
    G = SE3.exp([0.0, 0.0, 0.4, 0.1, 0.0, 0.0])
    once = elevation_sigma(G, POINTS, SIGMAS)
    assert_allclose(elevation_sigma(G, POINTS, SIGMAS / 2), once / 2, rtol=1e-12)
    worse = elevation_sigma(G, POINTS, SIGMAS, np.eye(6) * 1e-4)
    assert (worse > once).all()
    assert_allclose(elevation_sigma(G, POINTS, SIGMAS, np.zeros((6, 6))), once, rtol=1e-12)
    assert elevation_sigma(G, POINTS.reshape(2, 2, 3), SIGMAS).tolist() == once.reshape(2, 2).tolist()


def test_what_cannot_be_is_refused() -> None:
    G = SE3.identity()
    for match, arguments in (
        ("1 motions, points", (POINTS[:, :2], SIGMAS)),
        ("sigmas", (POINTS, [0.01, 0.0])),
        (r"motion_covariance has shape \(3, 3\)", (POINTS, SIGMAS, np.eye(3))),
    ):
        with pytest.raises(GraphError, match=match):
            elevation_sigma(G, *arguments)
    with pytest.raises(SingularGeometryError, match="z axis"):
        elevation_sigma(SE3.exp([4.0, 0, 1.0, 0, 0, 0]), [4.0, 0.0, 0.0], SIGMAS)


def test_the_picture_says_how_to_fly() -> None:
    figure = elevation_map(SONAR)
    panels = {axes.get_title().split()[0]: axes.texts[0].get_text() for axes in figure.axes[:6]}
    nothing = dict.fromkeys(("surge", "sway", "pitch", "yaw"), "nothing")
    assert panels == nothing | {"heave": "±1.5°", "roll": "±2.8°"}
    assert figure.get_suptitle() == "How should I fly? heave 0.3 m, roll 5° show the elevation"
    low, high = figure.axes[0].get_ylim()
    assert low > high  # down is down
    shown = figure.axes[2].collections[0].get_array()
    assert 0.2 < np.ma.count_masked(shown) / shown.size < 0.5  # heave loses the upper part of the window


def test_other_motions_and_a_view_that_sees_nothing(tmp_path: Path) -> None:
    flown = {"backwards": SE3.exp([0, 0, 0, 0, 0, 3.0]), "dive": SE3.exp([0, 0, 0.4, 0, 0, 0])}
    figure = elevation_map(SONAR, flown, distance=4.0, motion_covariance=np.eye(6) * 1e-6)
    assert [axes.get_title() for axes in figure.axes[:2]] == ["backwards", "dive"]
    assert [text.get_text() for text in figure.axes[0].texts] == ["out of sight"]
    assert figure.get_suptitle() == "How should I fly? dive shows the elevation"
    assert elevation_map(SONAR, {"stay": SE3.identity()[0]}).get_suptitle().endswith("the elevation stays unknown")
    path = tmp_path / "map.png"
    write_picture(path, figure)
    assert path.stat().st_size > 10_000
    for distance in (0.5, 7.0):
        with pytest.raises(OptionError, match="distance"):
            elevation_map(SONAR, distance=distance)
    with pytest.raises(OptionError, match="flown"):
        elevation_map(SONAR, {})


def test_the_old_name_warns_and_is_the_same_function() -> None:
    """The old name said information of what is a standard deviation."""
    with pytest.warns(DeprecationWarning, match="elevation_sigma") as warned:
        old = nls.sonar.elevation_information
    assert old is elevation_sigma
    assert warned[0].filename == __file__
    assert not hasattr(nls.missions.sonar, "elevation_deviation")


ELEVATIONS = np.radians([-6.0, -2.0, 0.05, 1.5, 5.0])
SPREAD = 0.01, 0.005


def seen_from(steps: Array) -> tuple[FactorGraph, Values, Array]:
    """Points at these elevations, 4 m away, seen exactly from the origin and after steps (n, 3); and their places."""
    p = 4.0 * np.column_stack([np.cos(ELEVATIONS), 0 * ELEVATIONS, np.sin(ELEVATIONS)])
    views = np.vstack([np.zeros((1, 3)), steps])
    poses = np.column_stack([views, np.zeros((len(views), 3)), np.ones(len(views))])
    i, k = (grid.ravel() for grid in np.mgrid[: len(views), : len(p)])
    contacts = RangeAzimuth(x[i], l[k], spherical(p[k] - views[i])[0][:, :2], Diagonal(SPREAD))
    return FactorGraph([contacts]), Values({x: (SE3, poses), l: (R(3), p)}), p


def doubtful(graph: FactorGraph, values: Values, p: Array) -> Mask:
    S = np.tile(SE3.identity(), (len(p), 1))
    return mirrored(graph, values, l[np.arange(len(p))], S, spherical(p)[0], np.full(len(p), np.radians(0.3)))


@for_all(heave=[0.0, 0.05, 1.0])
def test_against_chi2_on_a_fine_grid(heave: float) -> None:
    """Heave moves the other minimum away from the mirror image before it lifts it."""
    steps = np.array([[0.5, 0.0, heave], [0.0, 1.0, -heave]])
    graph, values, p = seen_from(steps)
    other = -np.sign(ELEVATIONS)[:, None] * np.linspace(0, np.radians(7), 4000)
    q = 4.0 * np.stack([np.cos(other), 0 * other, np.sin(other)], axis=-1)
    chi2 = np.zeros(other.shape)
    for step in steps:
        e = spherical((q - step).reshape(-1, 3))[0][:, :2].reshape(*other.shape, 2)
        chi2 += np.square((e - spherical(p - step)[0][:, None, :2]) / SPREAD).sum(axis=-1)
    alike = chi2.min(axis=1) < 9
    assert doubtful(graph, values, p).tolist() == (alike & (np.arange(5) != 2)).tolist()  # one is near to its image
    assert alike.all() == (heave < 1)


def test_a_landmark_without_a_sigma_or_held_is_not_doubted() -> None:
    """Nor one near the plane of the sonar: its sigma reaches both places."""
    graph, values, _ = seen_from(np.array([[3.0, 0.0, 0.0], [3.0, 1.0, 0.0]]))
    graph.fix(x[[0, 1, 2]])
    assert elevations(graph, values, sigmas=True).mirrored[[0, 2, 4]].tolist() == [True, False, True]
    assert not elevations(graph, values).mirrored.any()
    graph.fix(l[0])
    assert elevations(graph, values, sigmas=True).mirrored[[0, 2, 4]].tolist() == [False, False, True]


LIMIT, SOFTNESS = radians(7.0), radians(1.0)


def two_views(heave: float, elevation: float) -> tuple[FactorGraph, Values]:
    """Two poses known to 0.1 mm, and a point at an elevation in the first, seen from both."""
    poses = np.array([[0, 0, 0, 0, 0, 0, 1], [0, 0, heave, 0, 0, 0, 1]], dtype=float)
    p = 4.0 * np.array([[np.cos(elevation), 0.0, np.sin(elevation)]])
    seen = spherical(np.concatenate([p, p - [0, 0, heave]]))[0][:, :2]
    contacts = RangeAzimuth(x[[0, 1]], l[[0, 0]], seen, Diagonal(range=0.01, azimuth=0.005))
    graph = FactorGraph([Prior(x[[0, 1]], poses, Isotropic(1e-4)), contacts])
    return graph, Values({x: (SE3, poses), l: (R(3), p)})


def assert_covariance(graph: FactorGraph, values: Values) -> None:
    """What is said of the place of the landmark has the sigma along its arc; elsewhere it lost nothing, or gained."""
    found, Sigma = elevations(graph, values, sigmas=True), Marginals(graph, values).all(l)
    bounded, along = found.bounded(Sigma)[0], found.along[0]
    assert np.sqrt(along @ bounded @ along) / 4.0 == pytest.approx(found.sigma[0], rel=0.01)
    assert np.linalg.eigvalsh(bounded)[0] > 0
    grown = (found.sigma**2 - found.before**2)[0]
    if grown == 0:
        np.testing.assert_array_equal(bounded, Sigma[0])
        return
    bow = 0.75 * (4.0 * max(grown, 0.0)) ** 2 * np.outer(found.ahead, found.ahead)
    change = np.linalg.eigvalsh(bounded - bow - Sigma[0])
    one = change[2] if grown > 0 else change[0]  # a rank of 1, of one sign
    assert one * grown > 0
    assert np.sort(np.abs(change))[1] < 1e-9 * abs(one)


@for_all(heave=[0.05, 0.3, 1.0])
def test_the_aperture_stands_in_for_hinges_that_push(heave: float) -> None:
    graph, start = two_views(heave, elevation=LIMIT + 0.02)
    hinge = ElevationHinge(x[[0, 1]], l[[0, 0]], LIMIT, SOFTNESS)
    hinged = FactorGraph([*graph.factors, hinge[[0]]])
    found, before = (elevations(g, start, sigmas=True) for g in (hinged, graph))
    assert (found.pushed.tolist(), before.pushed.tolist()) == ([True], [False])
    v = LIMIT**2 / 3 + found.elevation**2
    assert found.sigma == pytest.approx(1 / np.sqrt(1 / before.before**2 + 1 / v), rel=1e-3)
    assert_covariance(hinged, start)


@for_all(heave=[0.3, 0.01])
def test_inside_the_aperture_no_elevation_is_known_less_well_than_by_it(heave: float) -> None:
    better = heave < 0.1
    graph, start = two_views(heave, elevation=LIMIT - 0.02)
    hinged = FactorGraph([*graph.factors, ElevationHinge(x[[0, 1]], l[[0, 0]], LIMIT, SOFTNESS)])
    found, before = (elevations(g, start, sigmas=True) for g in (hinged, graph))
    assert not found.pushed.any()
    np.testing.assert_allclose(found.before, before.sigma, rtol=1e-9)
    by_aperture = np.sqrt(LIMIT**2 / 3 + found.elevation**2)
    assert (before.sigma > by_aperture).all() == better
    np.testing.assert_allclose(found.sigma, by_aperture if better else before.sigma, rtol=1e-9)
    assert_covariance(hinged, start)


@pytest.mark.filterwarnings("error")
def test_landmarks_that_are_held_are_not_pushed() -> None:
    graph, start = two_views(0.3, elevation=LIMIT + 0.02)
    hinged = FactorGraph([*graph.factors, ElevationHinge(x[0], l[0], LIMIT, SOFTNESS)])
    hinged.fix(l[0])
    found = elevations(hinged, start, sigmas=True)
    assert not found.pushed.any()
    assert not found.bounded(Marginals(hinged, start).all(l)).any()  # a place that is given
    hinged.fix(x[0])  # then the elevation is given, too
    assert elevations(hinged, start, sigmas=True).sigma == pytest.approx(0.0, abs=1e-6)


def test_errors_of_pushed_landmarks_fit_their_sigmas() -> None:
    """Along the hull; as measurements the hinges would know elevations to 1 deg that are 10 deg off."""
    parts: list[tuple[Array, ...]] = []
    for seed in range(3):
        mission = sim.hauv_hull(np.random.default_rng(seed))
        values = mission.graph.optimize(mission.start, LevenbergMarquardt()).values
        found = elevations(mission.graph, values, sigmas=True)
        S = SE3.compose(mission.truth[x[found.poses]], mission.offset)
        true = mission.truth[l[found.landmarks]]
        error, p = found.elevation - spherical(SE3.act(SE3.inverse(S), true))[0][:, 2], found.pushed
        away = (values[l[found.landmarks]] - true)[p]
        Sigma = found.bounded(Marginals(mission.graph, values).covariance(l[found.landmarks]))[p]
        places = (away * np.linalg.solve(Sigma, away[..., None])[..., 0]).sum(axis=1)
        parts.append((np.square((error / found.before)[p]), np.square((error / found.sigma)[p]), places))
        parts[-1] += (np.square((error / found.sigma)[~p]),)
    hinges, limits, places, others = map(np.concatenate, zip(*parts, strict=True))
    assert min(len(limits), len(others)) > 50
    assert hinges.mean() > 10 > 1.5 > limits.mean()
    assert others.mean() == pytest.approx(1.0, abs=0.25)
    assert limits.max() < 2.5**2 < 10**2 < hinges.max()
    assert places.mean() == pytest.approx(3.0, abs=1.0)
