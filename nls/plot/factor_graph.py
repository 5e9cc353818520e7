"""A small factor graph as textbooks draw it: variables as circles, factors as squares on the lines between them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from models.errors import GraphError
from nls.plot.picture import axes_or_new, figure_of, full_legend
from nls.plot.style import ESTIMATE, HELD, LANDMARK, SERIES, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from factors.keys import Keys
    from models.algebra import Array
    from nls.graph import FactorGraph
    from nls.values import Values

MOST_VARIABLES = 60  # variables whose names can be read
APART, MARGIN = 0.28, 0.4  # of a line: between factors of the same variables; the rim
SQUARES = tuple(color for color in SERIES if color not in (ESTIMATE, LANDMARK))

Name = tuple[str, int]  # kind and number of a variable
Measurement = tuple[str, tuple[Name, ...]]  # name of its factor, and its variables


def factor_graph(graph: FactorGraph, values: Values | None = None, axes: Axes | None = None) -> Figure:
    """Every variable as a circle with its name, every measurement as a square with lines to its variables.

    Parameters
    ----------
    graph : of at most 60 variables. What is held fixed is gray.
    values : where the variables are, at x and y of the plane; of variables in space y is to the right and x up, as on a
        chart. Without values the poses, kind ``x``, are drawn in a row, and the other kinds above and below it.
    axes : where; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    GraphError
        No factor, too many variables, a variable without a position.

    Examples
    --------
    >>> from factors import Between, Isotropic, Landmark, Prior
    >>> from nls import FactorGraph, kinds
    >>> from nls.plot import factor_graph
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([
    ...     Prior(x[1], [0, 0, 0], Isotropic(0.1)),
    ...     Between(x[[1, 2]], x[[2, 3]], [[2, 0, 0], [2, 0, 0]], Isotropic(0.1)),
    ...     Landmark(x[[1, 2, 3]], l[[1, 1, 2]], [[2, 2], [0, 2], [0, 2]], Isotropic(0.1)),
    ... ])
    >>> [text.get_text() for text in factor_graph(graph).legends[0].get_texts()]
    ['Prior, 1', 'Between, 2', 'Landmark, 3']
    """
    measurements = [(factor.name, variables) for factor in graph.factors for variables in _rows(factor.keys)]
    names = sorted({name for _, variables in measurements for name in variables})
    if not names:
        raise GraphError("factor_graph: the graph has no factors; add one")
    if len(names) > MOST_VARIABLES:
        raise GraphError(
            f"factor_graph: {len(names)} variables, at most {MOST_VARIABLES} can be told apart. Draw the whole with "
            "nls.plot.trajectory, or a part of it: graph.only(masks)"
        )
    places = _in_rows(names, measurements) if values is None else _at_values(names, values)
    lengths = [np.linalg.norm(places[a] - places[b]) for _, line in measurements for a, b in pairwise(line)]
    unit = float(np.median(lengths)) if lengths and values is not None else 1.0  # rows are 1 apart
    center = None if values is None else np.mean(list(places.values()), axis=0)
    beside = _apart(np.array(_squares(measurements, places, unit, center)), np.array(list(places.values())), unit)
    drawn = np.array([*places.values(), *beside])
    low, high = drawn.min(axis=0) - MARGIN * unit, drawn.max(axis=0) + MARGIN * unit
    width, height = np.clip((high - low) / unit, (5.0, 1.5), (11.0, 9.0))
    alone = axes is None
    axes = axes_or_new(axes, (float(width), float(height) + (0.5 if values is None else 1.0)))

    squares: dict[str, list[Array]] = {}
    for (factor, variables), square in zip(measurements, beside, strict=True):
        squares.setdefault(factor, []).append(square)
        for name in variables:
            axes.plot(*np.stack([square, places[name]]).T, color=TRUE, linewidth=1.0, zorder=1)
    for k, (factor, points) in enumerate(squares.items()):
        style = {"color": SQUARES[k % len(SQUARES)], "linestyle": "none", "label": f"{factor}, {len(points)}"}
        axes.plot(*np.array(points).T, "s", markersize=9, zorder=3, **style)  # type: ignore[arg-type]
    held = {(keys.kind, number) for keys in graph.fixed for number in keys.numbers.tolist()} & set(names)
    for name in names:
        right, up = places[name].tolist()
        edge, text = ESTIMATE if name[0] == _row(names) else LANDMARK, f"{name[0]}{name[1]}"
        face = HELD if name in held else "white"
        # diameters are 25 points, the sides of squares 9
        axes.scatter(right, up, s=25**2, linewidth=1.8, zorder=2, facecolor=face, edgecolor=edge)
        axes.text(right, up, text, ha="center", va="center_baseline", fontsize=max(6, 13 - len(text)), zorder=4)
    if held:
        axes.scatter([], [], s=60, facecolor=HELD, edgecolor=TRUE, label="fixed")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    if values is None:
        axes.set_axis_off()
    else:
        space = values.stack(names[0][0]).manifold.position(values.stack(names[0][0]).X).shape[1] == 3
        axes.set(xlabel="y [m]" if space else "x [m]", ylabel="x [m]" if space else "y [m]")
    full_legend(axes, 4, alone)
    return figure_of(axes)


def _rows(keys: Sequence[Keys]) -> list[tuple[Name, ...]]:
    """The variables of every measurement of a factor."""
    return list(zip(*([(k.kind, n) for n in k.numbers.tolist()] for k in keys), strict=True))


def _row(names: Sequence[Name]) -> str:
    """The kind in the row: poses, or the kind of most variables where there are none."""
    kinds = [kind for kind, _ in names]
    return "x" if "x" in kinds else max(sorted(set(kinds)), key=kinds.count)


def _at_values(names: Sequence[Name], values: Values) -> dict[Name, Array]:
    """Places from above."""
    positions: dict[Name, Array] = {}
    for kind in sorted({kind for kind, _ in names}):
        stack = values.stack(kind)
        places = np.asarray(stack.manifold.position(stack.X))
        positions |= {(kind, number): place for number, place in zip(stack.numbers.tolist(), places, strict=True)}
    for name in names:
        if name not in positions or len(positions[name]) < 2:
            why = "has no position in the plane" if name in positions else "is not in these values"
            raise GraphError(f"factor_graph: {name[0]}{name[1]} {why}; leave out values, and all are drawn in rows")
    return {name: positions[name][[1, 0]] if len(positions[name]) == 3 else positions[name] for name in names}


def _in_rows(names: Sequence[Name], measurements: Sequence[Measurement]) -> dict[Name, Array]:
    """Poses from left to right; the other kinds above and below, each variable over the middle of its neighbors."""
    row = _row(names)
    out = {name: np.array([float(k), 0.0]) for k, name in enumerate(name for name in names if name[0] == row)}
    for level, kind in enumerate(sorted({kind for kind, _ in names} - {row})):
        height = (1 + level // 2) * (1 - 2 * (level % 2))
        wanted = []
        for name in (name for name in names if name[0] == kind):
            around = [other for _, variables in measurements if name in variables for other in variables]
            middle = [out[other][0] for other in around if other[0] == row]
            wanted.append((float(np.mean(middle)) if middle else 0.0, name))
        right = -np.inf
        for at, name in sorted(wanted):
            right = max(at, right + 1.0)
            out[name] = np.array([right, float(height)])
    return out


def _squares(
    measurements: Sequence[Measurement], places: dict[Name, Array], unit: float, center: Array | None
) -> list[Array]:
    """Where the squares are: in the middle of their variables, side by side where these are the same.

    That of one variable is on its far side, seen from the center; without a center it is above or below it.
    """
    sets = [frozenset(variables) for _, variables in measurements]
    out = []
    for k, variables in enumerate(sets):
        points = np.array([places[name] for name in sorted(variables)])
        middle, aside = points.mean(axis=0), sets[:k].count(variables) - (sets.count(variables) - 1) / 2
        if len(points) > 1:
            along = points[-1] - points[0]
            across = np.array([-along[1], along[0]]) / (np.linalg.norm(along) or 1.0)
            out.append(middle + aside * APART * unit * across)
            continue
        away = np.array([0.0, middle[1] or -1.0]) if center is None else middle - center
        angle = np.arctan2(away[1], away[0]) + aside * np.pi / 5
        # beside its only variable, 0.62 of a line away
        out.append(middle + 0.62 * unit * np.array([np.cos(angle), np.sin(angle)]))
    return out


def _apart(squares: Array, circles: Array, unit: float) -> Array:
    """Squares (n, 2) moved away from circles (m, 2) and from each other, where they would cover them."""
    # squares move away from circles and from each other
    for _ in range(30):
        pushes = np.zeros_like(squares)
        # the middles of a square and a circle are 0.36 of a line apart
        for others, least in ((circles, 0.36 * unit), (squares, APART * unit)):
            away = squares[:, None] - others
            distance = np.linalg.norm(away, axis=2)
            near = (distance < least) & ~((others is squares) & np.eye(len(squares), len(others), dtype=bool))
            same = np.where(np.arange(len(squares))[:, None] < np.arange(len(others)), -1.0, 1.0)  # to both sides
            direction = np.where(
                distance[..., None] > 1e-9 * unit,
                away / np.maximum(distance, 1e-9 * unit)[..., None],
                np.stack([np.zeros_like(same), same], axis=2),
            )
            pushes += np.sum((near * (least - distance) / 2)[..., None] * direction, axis=1)
        squares = squares + pushes
    return squares
