"""Paths that several worlds share: walks along the streets of a grid, body axes from directions, pairs that meet."""

from __future__ import annotations

import numpy as np

from models import SO3
from models.algebra import Array, Index
from models.errors import ResourceLimitError
from models.manifolds.so3 import quaternion_from_matrix
from models.options import check_positive
from sim.checks import check_not_negative, check_rng, check_size
from sim.world import chain

__all__ = ["attitudes", "grid_walk", "meetings", "quarter_turns"]

MAX_PAIRS = 50_000_000  # 800 MB
VISITS = 3  # how often a stretch of street is driven when the size of the city is left open


def grid_walk(
    rng: np.random.Generator, n_poses: int, dim: int, streets: int | None, block: int, spacing: float
) -> tuple[Array, Array]:
    """Positions and directions of a drive along the streets of a square or cubic city, with right-angle turns only.

    Each leg leads along one axis from the present cross street to another drawn at random, the next along another
    axis. A vehicle turns where it stands and then moves one step.

    Parameters
    ----------
    rng : source of the turns.
    n_poses : poses to drive.
    dim : 2 or 3.
    streets : parallel streets along each axis; None for as many as are driven about three times each.
    block : steps between two streets.
    spacing : length of a step, m.

    Returns
    -------
    positions : (n_poses, dim) array, m, from 0 to (streets - 1) * block * spacing.
    directions : (n_poses, dim) array, unit vectors of the step that follows.

    Raises
    ------
    OptionError
    """
    check_rng(rng)
    check_size("n_poses", n_poses, 3)
    check_size("block", block, 1)
    check_positive(spacing=spacing)
    if streets is None:
        # between two streets alone a drive only circles the block
        streets = max(3, round((n_poses / (VISITS * dim * block)) ** (1 / dim)))
    check_size("streets", streets, 2)
    legs = -(-n_poses // block)  # enough: the shortest leg is one block
    axis = np.cumsum(rng.integers(1, dim, size=legs)) % dim  # never the axis of the leg before
    jump = rng.integers(1, streets, size=legs)  # never to the street where it stands
    corners = np.cumsum((axis[:, None] == np.arange(dim)) * jump[:, None], axis=0) % streets  # (legs, dim)
    moves = np.diff(corners, axis=0, prepend=np.zeros((1, dim), dtype=corners.dtype))
    length = np.minimum(np.abs(moves).sum(axis=1) * block, n_poses)  # steps per leg, no more than are driven
    driven = int(np.searchsorted(np.cumsum(length), n_poses)) + 1
    directions = np.repeat(np.sign(moves[:driven]), length[:driven], axis=0)[:n_poses].astype(float)
    positions = np.zeros((n_poses, dim))
    np.cumsum(directions[:-1], axis=0, out=positions[1:])
    return spacing * positions, directions


def quarter_turns(directions: Array) -> Array:
    """Attitudes (n, 4) of a vehicle that looks along axis-parallel directions (n, 3) and turns by the shortest way."""
    d = directions
    first = attitudes(d[:1], np.roll(d[:1], 1, axis=1))[0]
    turns = SO3.exp(np.pi / 2 * np.cross(d[:-1], d[1:]))  # in world axes: R <- Exp(w) R
    return SO3.inverse(chain(SO3, SO3.inverse(first), SO3.inverse(turns)))


def attitudes(forward: Array, up: Array) -> Array:
    """Unit quaternions (n, 4), body to world: x along `forward` (n, 3), z as near as it gets to `up` (n, 3)."""
    x = forward / np.linalg.norm(forward, axis=-1, keepdims=True)
    y = np.cross(up, x)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return quaternion_from_matrix(np.stack([x, y, np.cross(x, y)], axis=-1))


def meetings(
    rng: np.random.Generator, positions: Array, radius: float, gap: int, closure_ratio: float
) -> tuple[Index, Index]:
    """Pairs of poses near each other but not along the path: where loops close.

    Parameters
    ----------
    rng : source of the choice.
    positions : (n, 2 or 3) array, m.
    radius : how near, m.
    gap : how many steps apart along the path at least.
    closure_ratio : closures per pose; so many of the pairs are drawn at random, all where there are fewer.

    Returns
    -------
    i, j : (k,) arrays with i < j, sorted.

    Raises
    ------
    OptionError
    ResourceLimitError
        So many pairs are near each other that listing them would take 800 MB.
    """
    from scipy.spatial import cKDTree

    check_positive(radius=radius)
    check_not_negative(closure_ratio=closure_ratio)
    tree = cKDTree(positions)
    near = int(tree.count_neighbors(tree, radius)) // 2  # counted first: the pairs grow with the square of the poses
    if near > MAX_PAIRS:
        raise ResourceLimitError(
            f"radius: {near} pairs of poses are within {radius:g} m, at most {MAX_PAIRS} are searched for loop "
            "closures; choose a smaller radius",
            16 * near,
            16 * MAX_PAIRS,
            "pairs",
        )
    pairs = tree.query_pairs(radius, output_type="ndarray")
    pairs = pairs[np.abs(pairs[:, 1] - pairs[:, 0]) >= gap]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]  # the tree's own order is nobody's promise
    count = min(len(pairs), round(closure_ratio * len(positions)))
    chosen = pairs[np.sort(rng.choice(len(pairs), size=count, replace=False))] if count else pairs[:0]
    return chosen[:, 0].astype(np.intp), chosen[:, 1].astype(np.intp)
