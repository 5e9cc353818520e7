"""Points as PLY, which CloudCompare, MeshLab and others open: binary, x, y and z as 64-bit floats.

Source: G. Turk, "The PLY polygon file format", 1994.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.algebra import Array, Numbers
from models.errors import GraphError
from models.listing import several
from nls.io.charts.chart import Chart
from nls.io.charts.crs import Projection
from nls.values import Values

__all__ = ["cloud_text", "ply_text", "points_text"]


def points_text(chart: Chart, projection: Projection | None = None) -> bytes:
    """The points of a chart: north, east and down, or easting, northing and up in a projection of the Earth."""
    kinds_of = [(points.name, points.numbers, points.p) for points in chart.points]
    if len(chart.bottom):
        kinds_of.append(("bottom", np.arange(len(chart.bottom)), chart.bottom))
    p = np.concatenate([place for _, _, place in kinds_of])
    axes = "x north, y east, z down, m"
    if projection is not None and projection.plane is not None:
        axes, p = (
            f"x easting, y northing of {projection.name}, z up, m",
            np.column_stack([projection.east_north(p), -p[:, 2]]),
        )
    kinds = np.repeat(np.arange(len(kinds_of)), [len(place) for _, _, place in kinds_of])
    names = ", ".join(f"{k} {name}" for k, (name, _, _) in enumerate(kinds_of))
    return ply_text(p, kinds, np.concatenate([numbers for _, numbers, _ in kinds_of]), [axes, f"kind: {names}"])


def cloud_text(path: str | Path, values: Values) -> tuple[bytes, list[str]]:
    """Positions of all poses and points, those of the plane at z = 0, and what is left out.

    Raises
    ------
    GraphError
        Nothing has a position; more kinds than the 256 a file has numbers for.
    """
    stacks = [s for s in values.stacks.values() if s.manifold.position(s.X).shape[1] in (2, 3) and len(s)]
    if not stacks or len(stacks) > 256:
        raise GraphError(
            f"{path}: a ply file holds poses and points, of 1 to 256 kinds; these values have {len(stacks)}"
        )
    p = [np.asarray(stack.manifold.position(stack.X)) for stack in stacks]
    flat = [np.pad(q, ((0, 0), (0, 3 - q.shape[1]))) for q in p]
    kinds = np.repeat(np.arange(len(stacks)), [len(stack) for stack in stacks])
    comment = "kind: " + ", ".join(f"{k} {stack.kind}" for k, stack in enumerate(stacks))
    numbers = np.concatenate([stack.numbers for stack in stacks])
    left = len(values) - len(numbers)
    notes = [f"a ply file holds positions: {several(left, 'variable')} without left out"] if left else []
    return ply_text(np.concatenate(flat), kinds, numbers, ["m", comment]), notes


def ply_text(p: Array, kinds: Numbers, numbers: Numbers, comments: list[str]) -> bytes:
    """The bytes of a PLY file.

    Parameters
    ----------
    p : (n, 3) points, m.
    kinds : (n,) which of the kinds named in a comment a point is of, property ``kind``.
    numbers : (n,) of the variables, property ``number``; -1 from 2^31 on, which a file cannot hold.
    comments : lines of the header.

    Examples
    --------
    >>> text = ply_text(np.eye(3)[:2], np.array([0, 1]), np.array([7, 8]), ["x north"])
    >>> text.split(b"end_header\\n")[0].decode().splitlines()[3]
    'element vertex 2'
    """
    head = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    head += [f"element vertex {len(p)}", *(f"property double {axis}" for axis in "xyz")]
    head += ["property uchar kind", "property int number", "end_header"]
    table = np.empty(len(p), dtype=[("p", "<f8", 3), ("kind", "u1"), ("number", "<i4")])
    table["p"], table["kind"] = p, kinds
    table["number"] = np.where(np.abs(numbers) < 2**31, numbers, -1)
    return ("\n".join(head) + "\n").encode("ascii", "backslashreplace") + table.tobytes()
