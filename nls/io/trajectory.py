"""Trajectories alone, as evaluation tools exchange them: TUM and KITTI text files, poses of space.

    TUM      timestamp tx ty tz qx qy qz qw        seconds; lines that begin with # are comments
    KITTI    r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz      the upper 3 x 4 of the pose, row by row

Body to world, meters. Poses of the plane are written in the plane z = 0. Sources: J. Sturm et al., "A benchmark for the
evaluation of RGB-D SLAM systems", IROS 2012; A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving?",
CVPR 2012.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from models import SE2, SE3
from models.advice import Advice
from models.algebra import Array
from models.errors import GraphError
from models.finite import numbers
from models.listing import several
from models.manifolds.so3 import quaternion_from_matrix, rotation3
from nls.graph import FactorGraph
from nls.io.files import write_bytes
from nls.io.formats import suffix_of
from nls.io.report import LoadReport
from nls.io.text import plain_table, refuse_late
from nls.io.unused_lines import note_comments
from nls.values import Stack, Values


def load_trajectory(path: str | Path, convention: str = "g2o") -> tuple[FactorGraph, Values, LoadReport]:
    """No measurements, the poses of a file as variables x, and a report with their times; the name says the format.

    Raises
    ------
    GraphFileError
        As for `read_tum` and `read_kitti`.
    """
    form = suffix_of(path)[1:]
    times, X, comments = _tum(path) if form == "tum" else _kitti(path)
    report = LoadReport(str(path), form, "3-D", convention, {"poses": len(X)}, reason="by its name")
    if times is not None:
        report.vertex_times["x"] = times
    note_comments(report, comments)
    return FactorGraph(), Values({"x": (SE3, X)}), report


def read_tum(path: str | Path) -> tuple[Array, Array]:
    """Times and poses of a TUM trajectory.

    Returns
    -------
    times : (n,) array, s, rising.
    poses : (n, 7) array, SE3 as x y z qx qy qz qw, m.

    Raises
    ------
    GraphFileError
        With the line: another count of numbers, a word that is no number; a quaternion that is not of length 1, a time
        that does not rise.
    """
    times, poses, _ = _tum(path)
    return times, poses


def _tum(path: str | Path) -> tuple[Array, Array, int]:
    """Times, poses and how many comments."""
    text, lines, table, comments = plain_table(path, 8, "timestamp tx ty tz qx qy qz qw", "pose")
    times, poses = table[:, 0], table[:, 1:]
    if (invalid := SE3.invalid(poses)) is not None:
        raise text.error(invalid[1], int(lines[invalid[0]]))
    refuse_late(text, lines, times)
    return times, poses, comments


def write_tum(path: str | Path, times: npt.ArrayLike, poses: npt.ArrayLike) -> None:
    """Write a TUM trajectory; it reads back bit for bit.

    Parameters
    ----------
    path : the file; gzip-compressed where the name ends in ``.gz``.
    times : (n,), s, rising.
    poses : (n, 7) SE3, or (n, 3) SE2, which are lifted to z = 0.

    Raises
    ------
    GraphError
        Not one rising time per pose, or no poses.
    GraphFileError
        The file cannot be written.
    """
    write_bytes(path, tum_text(path, times, poses))


def tum_text(path: str | Path, times: npt.ArrayLike, poses: npt.ArrayLike) -> bytes:
    """The bytes `write_tum` writes; the path is for messages."""
    X = _some(path, poses)
    t = numbers(str(path), "times", times)
    if t.shape != (len(X),):
        raise GraphError(f"{path}: times have shape {t.shape}, expected ({len(X)},): one per pose")
    if not (np.isfinite(t).all() and (t[1:] > t[:-1]).all()):
        raise GraphError(f"{path}: the times of a trajectory must be finite and rise")
    return _text(np.column_stack([t, X]))


def read_kitti(path: str | Path) -> Array:
    """Poses (n, 7) of a KITTI trajectory, SE3 as x y z qx qy qz qw, m.

    Raises
    ------
    GraphFileError
        With the line: another count of numbers, a word that is no number, a matrix that is no rotation.
    """
    return _kitti(path)[1]


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a matrix that overflows is no rotation, and is refused
def _kitti(path: str | Path) -> tuple[None, Array, int]:
    """No times, poses and how many comments."""
    text, lines, table, comments = plain_table(path, 12, "the upper 3 x 4 of a pose, row by row", "pose")
    T = table.reshape(-1, 3, 4)
    R = T[:, :, :3]
    off = np.abs(R @ R.mT - np.eye(3)).max(axis=(1, 2), initial=0.0)
    rotations = off <= 1e-3  # files of six digits are off by 1e-6

    def problem(k: int) -> str:
        why = f"R R' is off the identity by {off[k]:.3g}" if not rotations[k] else "its determinant is -1"
        return f"no rotation matrix: {why}"

    text.refuse(~rotations | (np.linalg.det(R) < 0), lines, problem)
    return None, np.hstack([T[:, :, 3], quaternion_from_matrix(R)]), comments


def write_kitti(path: str | Path, poses: npt.ArrayLike) -> None:
    """Write a KITTI trajectory; poses and errors as for `write_tum`. Rotations read back up to rounding."""
    write_bytes(path, kitti_text(path, poses))


def kitti_text(path: str | Path, poses: npt.ArrayLike) -> bytes:
    """The bytes `write_kitti` writes; the path is for messages."""
    X = _some(path, poses)
    return _text(np.concatenate([rotation3(X[:, 3:]), X[:, :3, None]], axis=2).reshape(-1, 12))


def lifted(poses: npt.ArrayLike) -> Array:
    """Poses of space (n, 7) from SE2 (n, 3) in the plane z = 0, or SE3 (n, 7) as they are.

    Raises
    ------
    GraphError
        Neither, or no numbers.

    Examples
    --------
    >>> import numpy as np
    >>> lifted([[1.0, 2.0, np.pi]]).round(6)
    array([[1., 2., 0., 0., 0., 1., 0.]])
    """
    X = np.atleast_2d(numbers("lifted", "poses", poses))
    if X.ndim != 2 or X.shape[1] not in (3, 7):
        raise GraphError(f"poses have shape {X.shape}, expected (n, 7): SE3, or (n, 3): SE2")
    if X.shape[1] == 7:
        return SE3.stack(X)
    x, y, theta = SE2.stack(X).T
    zero = np.zeros(len(X))
    return np.column_stack([x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)])


def _some(path: str | Path, poses: npt.ArrayLike) -> Array:
    """At least one pose of space."""
    try:
        X = lifted(poses)
    except GraphError as error:
        raise GraphError(f"{path}: {error}") from error
    if not len(X):
        raise GraphError(f"{path}: no poses; a trajectory file needs at least one")
    return X


def _text(table: Array) -> bytes:
    return "".join(" ".join(map(repr, row)) + "\n" for row in table.tolist()).encode()


def track_of(path: str | Path, values: Values, form: str = "") -> Stack:
    """The poses of a graph, which are of one kind besides places of sensors, o; the form, to write, is for the cure.

    Raises
    ------
    GraphError
        No poses, or several kinds.
    """
    poses = [stack for stack in values.stacks.values() if stack.manifold in (SE2, SE3) and stack.kind != "o"]
    if len(poses) != 1:
        names = ", ".join(stack.kind for stack in poses) or "none"
        other = [Advice("table"), Advice("native")] if form else []
        advice = [Advice("one kind", (stack.kind, form)) for stack in poses[:1] if form] + other
        message = f"{path}: a trajectory file holds the poses of one kind, this graph has {names}"
        raise GraphError(message, advice=advice)
    return poses[0]


def trajectory_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """Poses in the order of their times or numbers."""
    stack = track_of(path, values, form)
    known = {} if report is None else report.vertex_times
    timed = stack.kind in known
    times = known[stack.kind] if timed else stack.numbers.astype(float)
    order = np.argsort(times, kind="stable")
    X = np.array(stack.X)[order]
    if form == "kitti":
        data, notes = kitti_text(path, X), ["a kitti file holds no times"] * timed
    else:
        if not timed and (np.diff(times[order]) == 0).any():
            message = f"{path}: the numbers of the poses stand for times, and are too large to remain distinct"
            raise GraphError(message, advice=[Advice("table"), Advice("native")])
        data = tum_text(path, times[order], X)
        notes = ["the file has no times: the numbers of the poses stand for them"] * (not timed)
    if left := len(values) - len(stack):
        notes.append(f"a trajectory file holds poses only: {several(left, 'variable')} of other kinds left out")
    return data, notes
