"""What a second view tells about the elevation, against dense estimates and by kind of motion; and its picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import nls.sonar
from factors import Covariance, Diagonal, Prior, RangeAzimuth
from models import SE3, R
from models.errors import GraphError, OptionError
from models.sensors import DIDSON_HIGH, cartesian, elevation
from nls import FactorGraph, Marginals, SingularGeometryError, Values, kinds
from nls.missions.pictures.elevation_map import elevation_map, motions
from nls.missions.sonar import elevation_sigma
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
