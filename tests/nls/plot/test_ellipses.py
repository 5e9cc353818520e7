"""Ellipses of positions: their size, their axes, and which are drawn."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from factors import Diagonal, Prior
from models import SE2, SE3, SO3
from models.algebra import Array
from models.errors import OptionError
from nls import FactorGraph, Marginals, Values
from nls.plot import ellipses, trajectory
from tests.nls.graphs import Sample, l, mixed, pose_graph, x


def marginals_of(sample: Sample) -> Marginals:
    return Marginals(sample.graph, sample.values)


def outlines(axes: Axes) -> list[Array]:
    return [
        np.asarray(path.vertices) for c in axes.collections if isinstance(c, PolyCollection) for path in c.get_paths()
    ]


def drawn(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, dpi=20)
    return stream.getvalue()


def test_half_axes_by_hand() -> None:
    """Body sigmas 0.3 along and 0.1 across, heading 90 deg: 0.3 along y; 95 % is 2.4477 sigma in two dimensions."""
    graph = FactorGraph([Prior(x[0], [5.0, -2.0, np.pi / 2], Diagonal([0.3, 0.1, 0.01]))])
    marginals = Marginals(graph, Values({x: (SE2, [5.0, -2.0, np.pi / 2])}))
    (outline,) = outlines(ellipses(marginals).axes[0])
    drawn(ellipses(marginals))
    np.testing.assert_allclose(np.ptp(outline, axis=0) / 2, 2.4477 * np.array([0.1, 0.3]), rtol=0.01)
    np.testing.assert_allclose((outline.max(axis=0) + outline.min(axis=0)) / 2, [5.0, -2.0], atol=0.01)
    (half,) = outlines(ellipses(marginals, probability=0.5, scale=10).axes[0])
    np.testing.assert_allclose(np.ptp(half, axis=0) / 2, 11.774 * np.array([0.1, 0.3]), rtol=0.01)


def test_every_corner_is_at_the_same_distance_in_sigmas() -> None:
    sample = mixed(0)
    marginals = marginals_of(sample)
    figure = ellipses(marginals, probability=0.9)
    found = outlines(figure.axes[0])
    kinds = [(l, sample.values[l], marginals.all(l)), (x, sample.values[x][:, :2], marginals.all(x, view="position"))]
    expected = []
    for kind, t, Sigma in kinds:
        for k in np.argsort(sample.values.stack(kind.name).numbers):
            expected.append((t[k], Sigma[k]))
    assert len(found) == len(expected) == 10
    for outline, (t, Sigma) in zip(found, expected, strict=True):
        away = np.einsum("ni,ij,nj->n", outline - t, np.linalg.inv(Sigma), outline - t)
        np.testing.assert_allclose(away, -2 * np.log(0.1), rtol=1e-8)


def test_which_are_drawn() -> None:
    sample = pose_graph(SE2, anchored=False)
    axes = ellipses(marginals_of(sample), every=3).axes[0]
    assert len(outlines(axes)) == 3  # x1, x4, x7: x0 is held and has none
    t = sample.values[x][:, :2]
    centers = [(o.max(axis=0) + o.min(axis=0)) / 2 for o in outlines(axes)]
    np.testing.assert_allclose(centers, t[[1, 4, 7]], atol=1e-2)
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["95 % ellipse of every 3rd x"]
    many = pose_graph(SE2, n=300)
    marginals = marginals_of(many)
    axes = ellipses(marginals).axes[0]
    assert len(outlines(axes)) == 100
    texts = [text.get_text() for text in ellipses(marginals, scale=2, every=22).axes[0].get_legend().texts]
    assert texts == ["95 % ellipse of every 22nd x, 2 times as large"]


def test_in_space_they_lie_level() -> None:
    sample = pose_graph(SE3)
    marginals = marginals_of(sample)
    figure = trajectory(sample.graph, sample.values, marginals=marginals, every=2)
    assert drawn(figure).startswith(b"\x89PNG")
    (lines,) = (c for c in figure.axes[0].collections if "ellipse" in str(c.get_label()))
    segments = np.asarray(lines._segments3d)
    t = sample.values[x][::2, :3]
    assert segments.shape[0] == 4
    np.testing.assert_allclose(segments[:, :, 2], np.broadcast_to(t[:, 2:], segments.shape[:2]), atol=1e-12)
    Sigma = marginals.covariance(x[4], view="position")[:2, :2]
    away = segments[2, :, :2] - t[2, :2]
    np.testing.assert_allclose(np.sum(away @ np.linalg.inv(Sigma) * away, axis=1), -2 * np.log(0.05), rtol=1e-8)
    flat = ellipses(marginals)
    assert flat.axes[0].name == "rectilinear"
    assert len(outlines(flat.axes[0])) == 8


def test_with_the_trajectory() -> None:
    sample = pose_graph(SE2)
    without, figure = (trajectory(sample.graph, sample.values, marginals=m) for m in (None, marginals_of(sample)))
    assert not outlines(without.axes[0])
    assert len(outlines(figure.axes[0])) == 8
    texts = [text.get_text() for text in figure.legends[0].texts]
    assert texts == ["loop closures", "trajectory", "95 % ellipse of every x"]


def test_nothing_to_draw_and_wrong_options() -> None:
    sample = pose_graph(SO3)
    figure = ellipses(marginals_of(sample))
    assert not outlines(figure.axes[0])
    assert figure.axes[0].get_legend() is None
    drawn(figure)
    marginals = marginals_of(pose_graph(SE2))
    options: dict[str, int] = {"probability": 95, "every": 0, "scale": 0}
    for name, value in options.items():
        with pytest.raises(OptionError, match=f"{name}: {value} is not possible"):
            ellipses(marginals, **{name: value})  # type: ignore[arg-type]
