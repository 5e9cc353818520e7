"""Bundle adjustment in the large: cameras, points and the pixels where they meet.

    cameras points observations
    camera point x y                 one line per observation: pixels, origin at the image center, y up
    R1 R2 R3 t1 t2 t3 f k1 k2        nine numbers per camera, usually one a line: rotation vector, translation, lens
    X Y Z                            three per point, meters (or the unit of the reconstruction)

Cameras and points are counted from 0 and have no names. A camera becomes two variables of its number, so that its lens
can be held. `c` is the rotation vector and translation that take the world into the camera, `k` the focal length and
two distortions. Points are `l`. The file states no noise: one pixel is taken.

Source: S. Agarwal, N. Snavely, S. Seitz, R. Szeliski, "Bundle adjustment in the large", ECCV 2010, and its data sets.
"""

from pathlib import Path

import numpy as np

from factors.base import Factor
from factors.bundle import CAMERA, LENS, BundleProjection
from factors.keys import Keys
from factors.noise import Isotropic
from models import R
from models.algebra import Index, Numbers
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.io.report import LoadReport, Source
from nls.io.text import Text
from nls.io.write import refuse_held, unwritable
from nls.values import Stack, Values

KINDS = {"c": CAMERA, "k": LENS, "l": R(3)}
FILE = "a bundle-adjustment file"


def read_bal(data: bytes, path: str) -> tuple[FactorGraph, Values, LoadReport]:
    """Graph, start values and report of the bytes of a bundle-adjustment file.

    Raises
    ------
    GraphFileError
        With the line, for anything that cannot be right.

    Examples
    --------
    >>> text = b"1 1 1  0 0 10.5 -3  0 0 0  0 0 0  500 0 0  0.1 0.2 -5".replace(b"  ", b"\\n")
    >>> graph, values, report = read_bal(text, "one.txt")
    >>> graph.factors[0], graph.factors[0].z.tolist(), report.tags
    (BundleProjection(c0, k0, l0), [[10.5, -3.0]], {'cameras': 1, 'points': 1, 'observations': 1})
    """
    text = Text(data, path)
    count = np.diff(text.first)
    lines = np.flatnonzero(count)
    if not len(lines):
        raise text.error("is empty; expected a line 'cameras points observations'", 0)
    if count[lines[0]] != 3:
        raise text.error("expected three counts: cameras points observations", int(lines[0]))
    cameras, points, observations = text.whole(np.repeat(lines[:1], 3), np.arange(3)).tolist()
    if min(cameras, points, observations) < 1:
        raise text.error("expected at least one camera, one point and one observation", int(lines[0]))

    rows = lines[1 : 1 + min(observations, len(lines))]
    expected = "expected 4: camera point x y"
    text.refuse(
        count[rows] != 4, rows, lambda k: f"observation {k} of {observations} has {count[rows[k]]} numbers, {expected}"
    )
    if len(rows) < observations:
        message = f"the file ends after {len(rows)} observations, its first line announces {observations}"
        raise text.error(message, int(lines[-1]))
    i = _index(text, rows, 0, cameras, "camera")
    j = _index(text, rows, 1, points, "point")
    z = text.words(rows, 2, 2)

    first, last = int(text.first[rows[-1] + 1]), len(text.starts)
    needed = 9 * cameras + 3 * points
    if last - first != needed:
        message = f"{last - first} numbers follow the observations, expected 9 x {cameras} + 3 x {points} = {needed}"
        missing = last - first < needed
        token, where = (
            (last - 1, "the file is cut off here") if missing else (first + needed, "this is the first too many")
        )
        raise text.error(f"{message}; {where}", _line(text, np.array([token]))[0])
    tokens = np.arange(first, last)
    numbers = text.numbers(tokens, _line(text, tokens), 1)
    camera, point = numbers[: 9 * cameras].reshape(-1, 9), numbers[9 * cameras :].reshape(-1, 3)

    values = Values({"c": (CAMERA, camera[:, :6]), "k": (LENS, camera[:, 6:]), "l": (R(3), point)})
    graph = FactorGraph([BundleProjection(Keys("c", i), Keys("k", i), Keys("l", j), z, Isotropic(1.0))])
    report = LoadReport(path, "bal", "3-D", "none", sources=[Source(path, rows + 1)])
    report.tags = {"cameras": cameras, "points": points, "observations": observations}
    report.notes.append("the file states no noise: 1 pixel is taken")
    return graph, values, report


def _index(text: Text, lines: Index, column: int, count: int, noun: str) -> Numbers:
    """Cameras or points of the observations, each counted from 0."""
    index = text.whole(lines, column)
    outside = (index < 0) | (index >= count)
    text.refuse(outside, lines, lambda k: f"{noun} {index[k]} is none of the {count}, which are counted from 0")
    return index


def _line(text: Text, tokens: Index) -> Index:
    """The line (counted from 0) that holds each token."""
    return np.searchsorted(text.first, tokens, side="right") - 1


def bal_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None = None
) -> tuple[bytes, list[str]]:
    """The bytes of a bundle-adjustment file, and no notes; the path is for messages.

    Reading, writing and reading again gives the same numbers bit for bit.

    Raises
    ------
    GraphError
        The format has no line for it: other factors or kinds, variables not counted from 0, variables held fixed; a
        lens that is not that of its camera, a noise other than one pixel.
    """
    for factor in graph.factors:
        if not isinstance(factor, BundleProjection):
            raise unwritable(str(path), factor, FILE)
    if missing := KINDS.keys() - values.stacks:
        raise GraphError(f"{path}: {FILE} needs the kinds c, k and l; there is no {min(missing)}")
    stacks = [_counted(str(path), values, *kind) for kind in KINDS.items()]
    if extra := values.stacks.keys() - KINDS:
        raise GraphError(f"{path}: {FILE} holds the kinds c, k and l, not {', '.join(sorted(extra))}")
    if len(stacks[0]) != len(stacks[1]):
        raise GraphError(f"{path}: {len(stacks[0])} cameras c and {len(stacks[1])} lenses k, expected one for each")
    refuse_held(str(path), graph, FILE)
    rows = [row for factor in graph.factors for row in _observations(str(path), factor, values)]
    cameras, lenses, points = (stack.X for stack in stacks)
    numbers = [*np.hstack([cameras, lenses]).reshape(-1).tolist(), *np.ascontiguousarray(points).reshape(-1).tolist()]
    out = [f"{len(cameras)} {len(points)} {len(rows)}", *rows, *map(repr, numbers)]
    return ("\n".join(out) + "\n").encode(), []


def _counted(path: str, values: Values, kind: str, manifold: object) -> Stack:
    """The stack of a kind whose variables are 0, 1, 2 ... in order."""
    stack = values.stack(kind)
    if stack.manifold is not manifold:
        raise GraphError(f"{path}: kind {kind} is in {stack.manifold}, {FILE} holds {manifold}")
    if not np.array_equal(stack.numbers, np.arange(len(stack))):
        raise GraphError(f"{path}: {FILE} counts the variables {kind} from 0, these have other numbers")
    return stack


def _observations(path: str, factor: Factor, values: Values) -> list[str]:
    """One line per measurement."""
    if factor.kernel is not None:
        raise unwritable(path, factor, FILE, f"it is robust, {factor.kernel!r}, which the file has no place for")
    camera, lens, point = factor.keys
    if not np.array_equal(camera.numbers, lens.numbers):
        raise unwritable(path, factor, FILE, "a camera and its lens must have the same number")
    model, _ = values.gather(factor)
    if model.W.ndim == 3 or not (model.W == 1).all():
        raise unwritable(path, factor, FILE, "the noise is not one pixel, and the file has no place for it")
    rows = zip(camera.numbers.tolist(), point.numbers.tolist(), model.z.tolist(), strict=True)
    return [f"{i} {j} {x!r} {y!r}" for i, j, (x, y) in rows]
