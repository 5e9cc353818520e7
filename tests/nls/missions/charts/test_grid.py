"""The grid of depths: medians of the cells, north first, corners on multiples of the cell."""

from __future__ import annotations

import numpy as np
import pytest

from nls.missions.charts import grid_text


def test_medians_and_corners() -> None:
    rng = np.random.default_rng(0)
    east_north, depth = rng.uniform([-7.3, 500.2], [52.0, 520.0], (400, 2)), rng.uniform(5, 9, 400)
    east_north[:2] = [-7.3, 500.2], [51.9, 519.9]
    head, body = (lines := grid_text(east_north, depth).decode().splitlines())[:6], lines[6:]
    columns, rows, x, y, cell, empty = (float(line.split()[1]) for line in head)
    assert (cell, x, y) == (1.0, -8.0, 500.0)
    grid = np.array([line.split() for line in body], dtype=float)
    assert grid.shape == (rows, columns) == (20, 60)
    for row in range(20):
        for column in range(60):
            low = np.array([x + column, y + 19 - row])
            inside = ((east_north >= low) & (east_north < low + 1)).all(axis=1)
            expected = np.median(depth[inside]) if inside.any() else empty
            assert grid[row, column] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("longest", "cell"), [(0.0, 0.01), (100.0, 1.0), (101.0, 2.0), (30_000.0, 500.0)])
def test_the_cell_is_a_round_number(longest: float, cell: float) -> None:
    text = grid_text(np.array([[0.0, 0.0], [longest, 0.0]]), np.array([1.0, 2.0])).decode()
    assert f"cellsize {cell!r}\n" in text
