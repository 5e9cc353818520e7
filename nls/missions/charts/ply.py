"""Points as PLY, which CloudCompare, MeshLab and others open: binary, x, y and z as 64-bit floats.

Source: G. Turk, "The PLY polygon file format", 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.algebra import Array, Numbers
from models.errors import GraphError
from models.listing import several
from nls.graph import FactorGraph
from nls.io.report import LoadReport
from nls.missions.charts.chart import Chart
from nls.missions.charts.crs import Projection
from nls.values import Values


def points_text(chart: Chart, projection: Projection | None = None) -> bytes:
    """The points of a chart: north, east and down, or easting, northing and up in a projection of the Earth."""
    parts = [(points.name, points.numbers, points.p) for points in chart.points]
    if len(chart.bottom):
        parts.append(("bottom", np.arange(len(chart.bottom)), chart.bottom))
    if projection is None or projection.plane is None:
        return ply_text(parts, "x north, y east, z down, m")
    parts = [(name, numbers, np.column_stack([projection.east_north(p), -p[:, 2]])) for name, numbers, p in parts]
    return ply_text(parts, f"x easting, y northing of {projection.name}, z up, m")


def cloud_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """Positions of all poses and points, those of the plane at z = 0, and what is left out.

    Raises
    ------
    GraphError
        Nothing has a position; more kinds than the 256 a file has numbers for.
    """
    stacks = [s for s in values.stacks.values() if s.manifold.position(s.X).shape[1] in (2, 3) and len(s)]
    if not stacks or len(stacks) > 256:
        expected = "a ply file holds poses and points, of 1 to 256 kinds"
        raise GraphError(f"{path}: {expected}; these values have {len(stacks)}")
    parts = [(stack.kind, stack.numbers, np.asarray(stack.manifold.position(stack.X))) for stack in stacks]
    left = len(values) - sum(map(len, stacks))
    notes = [f"a ply file holds positions: {several(left, 'variable')} without left out"] if left else []
    return ply_text(parts, "m"), notes


def ply_text(parts: Sequence[tuple[str, Numbers, Array]], axes: str, remark: str = "") -> bytes:
    """The bytes of a PLY file.

    Parameters
    ----------
    parts : points of one kind each: its name; (n,) the numbers of the variables, property ``number``, -1 from 2^31 on,
        which a file cannot hold; (n, 3) places, m, or (n, 2) at z = 0.
    axes, remark : of the places, and of the kinds, whose names are a comment and their numbers a property ``kind``.

    Examples
    --------
    >>> text = ply_text([("pose", np.array([7, 8]), np.eye(3)[:2])], "x north")
    >>> text.split(b"end_header\\n")[0].decode().splitlines()[3:5]
    ['comment kind: 0 pose', 'element vertex 2']
    """
    kinds = np.repeat(np.arange(len(parts)), [len(p) for _, _, p in parts])
    numbers = np.concatenate([numbers for _, numbers, _ in parts])
    names = ", ".join(f"{k} {name}" for k, (name, _, _) in enumerate(parts))
    head = ["ply", "format binary_little_endian 1.0", f"comment {axes}", f"comment kind: {names}{remark}"]
    head += [f"element vertex {len(kinds)}", *(f"property double {axis}" for axis in "xyz")]
    head += ["property uchar kind", "property int number", "end_header"]
    table = np.empty(len(kinds), dtype=[("p", "<f8", 3), ("kind", "u1"), ("number", "<i4")])
    table["p"] = np.concatenate([np.pad(p, ((0, 0), (0, 3 - p.shape[1]))) for _, _, p in parts])
    table["kind"] = kinds
    table["number"] = np.where(np.abs(numbers) < 2**31, numbers, -1)
    return ("\n".join(head) + "\n").encode("ascii", "backslashreplace") + table.tobytes()
