"""Unknowns of a grid of poses are eliminated one by one; in the order of their numbers the matrix fills up, in a good
order it stays nearly empty.

The matrix A'A of a grid of 7 x 7 poses, every pose one row; rows and columns in the order in which they are eliminated,
what an elimination adds is orange, and the gray square holds what is left. Left the order of the numbers, right the
minimum degree order, found step by step.
"""

from __future__ import annotations

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from models.algebra import Array
from nls.plot.style import SERIES

COLORS = ListedColormap(["white", SERIES[0], SERIES[1]])  # empty, measured, fill-in
SIDE = 7


def make() -> tuple[list[Figure], list[float]]:
    """Frames and seconds."""
    n = SIDE**2
    row, column = np.divmod(np.arange(n), SIDE)
    joined = abs(row[:, None] - row) + abs(column[:, None] - column) <= 1
    orders = {"in the order of the numbers": np.arange(n), "in minimum degree order": minimum_degree(joined)}
    steps = [eliminated(joined[np.ix_(order, order)]) for order in orders.values()]
    assert steps[1][-1][1] < 0.75 * steps[0][-1][1]
    frames = [_drawn(orders, [s[k] for s in steps], k) for k in range(0, n, 2)]
    return frames, [1.0, *[0.15] * (len(frames) - 2), 3.0]


def minimum_degree(joined: Array) -> Array:
    """Always the unknown with the fewest neighbors next; its neighbors become neighbors of each other."""
    A, left, order = joined.copy(), np.ones(len(joined), dtype=bool), []
    for _ in range(len(A)):
        degree = np.where(left, (A & left).sum(axis=1), len(A) + 1)
        k = int(np.argmin(degree))
        near = A[k] & left
        A |= np.outer(near, near)
        left[k] = False
        order.append(k)
    return np.array(order)


def eliminated(A: Array) -> list[tuple[Array, int]]:
    """After each elimination, what every entry is (an index of COLORS), and how many were added above the diagonal."""
    now, out = A.copy(), []
    for k in range(len(A)):
        near = now[k].copy()
        near[:k] = False
        now |= np.outer(near, near)
        what = now.astype(int) + (now & ~A)
        out.append((what, int(np.triu(now & ~A).sum())))
    return out


def _drawn(orders: dict[str, Array], states: list[tuple[Array, int]], last: int) -> Figure:
    figure = Figure(figsize=(8, 4.4))
    for side, (name, (what, fill)) in enumerate(zip(orders, states, strict=True)):
        axes = figure.add_axes((0.03 + 0.49 * side, 0.02, 0.46, 0.84))
        axes.imshow(what, cmap=COLORS, vmin=0, vmax=2, interpolation="nearest")
        left = len(what) - 1 - last
        axes.add_patch(Rectangle((last + 0.5, last + 0.5), left, left, fill=False, edgecolor="0.5", linewidth=1.5))
        axes.set(xticks=[], yticks=[])
        numbers = "number" if fill == 1 else "numbers"
        axes.set_title(f"{name}:\n{fill} {numbers} of fill-in")
    return figure
