"""A graph as a mission folder: the files `read_mission` reads, numbers bit for bit."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors import XYH, ZPR, Between, Diagonal, Elevation, Heading, Isotropic, Position, Prior, Range, RangeAzimuth
from factors.base import Factor
from factors.robust import KERNELS, Robust
from models import SE3, euler
from models.algebra import Array, Numbers
from models.errors import GraphError, GraphFileError
from nls.graph import FactorGraph
from nls.io.files import write_folder
from nls.missions.folder.columns import ARM, COLUMNS, COMPASS, CONTACT, LEVEL, PLACE, POSE, TILT, TRACK, suffixed
from nls.missions.folder.rows import NO_KERNEL
from nls.missions.folder.table import csv_text
from nls.values import Values

if TYPE_CHECKING:
    from models.sensors import ImagingSonar

Columns = dict[str, npt.ArrayLike]
MEASURED = {"odometry": (("i", "j"), LEVEL), "zpr": (("i",), TILT), "contacts": (("i", "landmark"), CONTACT)}


def write_mission(
    folder: str | Path,
    graph: FactorGraph,
    sonar: ImagingSonar | None = None,
    offset: npt.ArrayLike | None = None,
    truth: Values | None = None,
    times: npt.ArrayLike | None = None,
) -> list[str]:
    """Write a mission folder, which is made where there is none.

    Parameters
    ----------
    folder : where.
    graph : `XYH` and `ZPR` of poses ``x``; `Heading` of a compass, for every pose of `ZPR` or none; the anchor, a
        `Prior` of x, y and yaw, or `Position` and `Heading` of the same poses; `RangeAzimuth` of landmarks ``l``;
        `Position` without a `Heading`, `Between` of poses, `Range` to beacons ``b`` and their `Prior`, also under
        robust kernels. Factors of the elevation have no file: sonar.csv says the aperture, and `read_mission` makes
        them. Of an anchor that is a `Prior`, x, y and yaw are written.
    sonar, offset : the sonar and its mounting (7,), SE3; None where it saw nothing, and where it is the vehicle.
    truth : true poses ``x`` and landmarks ``l``.
    times : (n,) of the poses, s, in the order of their numbers.

    Returns
    -------
    list of str
        The files that were written.

    Raises
    ------
    GraphError
        A factor, kind of variable or noise that no file has columns for; a pose that is not in the track; a fixed
        variable.
    GraphFileError
        The folder cannot be written, or holds files of another mission that would be mixed with these.

    Examples
    --------
    >>> import tempfile
    >>> from factors import XYH, ZPR, Diagonal
    >>> from nls import FactorGraph, kinds
    >>> (x,) = kinds("x")
    >>> step = XYH(x[0], x[1], [1.0, 0.2, 0.5], Diagonal(x=0.01, y=0.01, yaw=0.004))
    >>> tilt = ZPR(x[[0, 1]], [[5.0, 0.1, 0.0], [5.5, 0.2, -0.1]], Diagonal(z=0.01, pitch=0.002, roll=0.002))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = write_mission(folder, FactorGraph([step, tilt]))
    ...     print(Path(folder, "odometry.csv").read_text())
    i,j,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad
    0,1,1.0,0.2,0.5,0.01,0.01,0.004
    >>> [Path(file).name for file in files]
    ['odometry.csv', 'zpr.csv']
    """
    files = mission_files(graph, sonar, offset, truth, times)
    refuse_mixed(folder, files)
    return write_folder(folder, files)


def refuse_mixed(folder: str | Path, files: Collection[str]) -> None:
    """Refuse a folder with a file of another mission, which would be mixed with these files.

    Raises
    ------
    GraphFileError
    """
    path = Path(folder)
    for name in COLUMNS:
        for file in (path / f"{name}.csv", path / f"{name}.csv.gz"):
            if file.exists() and file.name not in files:
                cure = "remove it, or give another folder"
                raise GraphFileError(f"is of another mission, which would be mixed with this one; {cure}", str(file))


def mission_files(
    graph: FactorGraph,
    sonar: ImagingSonar | None = None,
    offset: npt.ArrayLike | None = None,
    truth: Values | None = None,
    times: npt.ArrayLike | None = None,
) -> dict[str, bytes]:
    """The files `write_mission` writes, by name; parameters and errors as there."""
    mount = SE3.identity()[0] if offset is None else SE3.stack(offset)[0]
    rows: dict[str, list[Columns]] = {}
    factors = [factor for factor in graph.factors if len(factor)]  # what measures nothing needs no file
    if held := [keys for keys in graph.fixed if len(keys)]:
        first = next(iter(held[0]))
        rest = "it by a factor instead: an anchor is a Position of x and y and a Heading, or a Prior of x, y and yaw"
        raise GraphError(f"write_mission: {first!r} is fixed, which no file of a mission states; fix {rest}", [first])
    tables, factors = _positioned(factors)
    for factor in factors:
        if (name := _file_of(factor, mount)) in MEASURED:
            rows.setdefault(name, []).append(_measured(factor, *MEASURED[name]))
    anchors, compass = _anchors(factors)
    if anchors:
        rows["anchor"] = anchors
    if sonar is not None:
        rows["sonar"] = [_sonar(sonar, mount)]
    for name, kind, number, names in (("truth", "x", "i", POSE[1:]), ("landmarks", "l", "landmark", PLACE)):
        if truth is not None and kind in truth.stacks:
            X = np.asarray(truth.stack(kind).X)
            places = _columns_of(names, euler.from_se3(X) if kind == "x" else X)
            rows[name] = [{number: truth.stack(kind).numbers} | places]
    if missing := [name for name in TRACK if name not in rows]:
        raise GraphError(f"write_mission: the graph has no factors for {missing[0]}.csv; a mission needs XYH and ZPR")
    if "contacts" in rows and sonar is None:
        raise GraphError("write_mission: the graph has contacts; give the sonar that saw them")
    if "contacts" not in rows and sonar is not None:
        raise GraphError("write_mission: the graph has no contacts; leave the sonar out")
    poses = _refuse_stray(rows, tables)
    if compass:
        rows["zpr"] = [_with_headings(_joined(rows["zpr"]), compass)]
    if times is not None:
        t = np.asarray(times, dtype=float)
        if t.shape != poses.shape or len(np.unique(t)) < len(t):
            reason = f"times of shape {t.shape}, expected {poses.shape}: one of its own for each pose"
            raise GraphError(f"write_mission: {reason}")
        order = np.argsort(t)
        rows["poses"] = [{"i": poses[order], "time_s": t[order]}]
    ordered = {name: rows[name] for name in COLUMNS if name in rows}
    return {f"{name}.csv": _table_text(name, parts) for name, parts in (ordered | tables).items()}


def _file_of(factor: Factor, mount: Array) -> str:
    """The file a factor is written to; anchor for its parts, and none for the elevation.

    Raises
    ------
    GraphError
        No file has columns for it.
    """
    kinds = [keys.kind for keys in factor.keys]
    expected = ["x", "l"] if isinstance(factor, RangeAzimuth | Elevation) else ["x"] * len(kinds)
    if kinds != expected:
        raise _no_file(factor, f"its variables are {kinds}, expected {expected}")
    if factor.kernel is not None:
        raise _no_file(factor, "it has a robust kernel; write the graph without")
    if isinstance(factor, RangeAzimuth | Elevation):
        own = SE3.identity() if factor.offset is None else np.asarray(factor.offset)
        if not (own == mount).all():
            raise _no_file(factor, "its offset is not the one given for sonar.csv")
        return "contacts" if isinstance(factor, RangeAzimuth) else ""
    if isinstance(factor, XYH) and factor.form != "levelled":
        raise _no_file(factor, "odometry.csv holds the levelled form")
    for name, kind in (("odometry", XYH), ("zpr", ZPR), ("anchor", Prior), ("anchor", Position), ("anchor", Heading)):
        if isinstance(factor, kind):
            return name
    rest = "ZPR, Heading, RangeAzimuth, Position, Between, Range to a beacon b, and an anchor"
    raise _no_file(factor, f"files hold XYH, {rest}")


def _refuse_stray(rows: dict[str, list[Columns]], tables: dict[str, list[Columns]]) -> Numbers:
    """Numbers of the poses of the track, rising; refuses what `read_mission` would.

    Raises
    ------
    GraphError
        A pose that is not in the track; two rows for a pose that has one.
    """
    poses = np.unique(_poses(rows["odometry"]))
    for name, parts in ({name: rows.get(name, []) for name in ("zpr", "anchor", "contacts")} | tables).items():
        unique_ids, count = np.unique(_poses(parts), return_counts=True)
        if len(stray := np.setdiff1d(unique_ids, poses)):
            raise GraphError(f"write_mission: x{stray[0]} is in {name}.csv, but no XYH connects it to the track")
        if name in ("zpr", "anchor") and (count > 1).any():
            problem = f"x{unique_ids[np.argmax(count)]} is measured twice in {name}.csv; expected once"
            raise GraphError(f"write_mission: {problem}")
    return poses


def _poses(rows: list[Columns]) -> Numbers:
    """Numbers of the poses in the rows of a table."""
    numbers = [np.asarray(row[column]) for row in rows for column in ("i", "j") if column in row]
    return np.concatenate([np.zeros(0, dtype=np.int64), *numbers])


def _anchors(factors: list[Factor]) -> tuple[list[Columns], list[Heading]]:
    """Rows of anchor.csv: priors of x, y and yaw, and positions each with its heading; and headings without a position.

    Of two headings of the same poses the later one is of the anchor, as `read_mission` adds them.
    """
    rows: list[Columns] = []
    for factor in factors:
        if isinstance(factor, Prior):
            if factor.components != ("x", "y", "yaw") or factor.offset is not None:
                raise _no_file(factor, "anchor.csv holds x, y and yaw: components=('x', 'y', 'yaw'), no offset")
            z = euler.from_se3(np.broadcast_to(factor.z, (len(factor), SE3.size)))[:, [3, 4, 2]]
            rows.append(_measured(factor, ("i",), LEVEL, z))
    headings = [factor for factor in factors if isinstance(factor, Heading)]
    for p in (factor for factor in factors if isinstance(factor, Position)):
        own = [k for k, h in enumerate(headings) if h.keys == p.keys]
        if not own or p.components != ("x", "y") or p.offset is not None:
            raise _no_file(p, "anchor.csv holds x, y and yaw: a Position of x and y, and a Heading of the same pose")
        h = headings.pop(own[-1])
        rows.append(_measured(p, ("i",), LEVEL[:2]) | _measured(h, ("i",), LEVEL[2:]))
    return rows, headings


def _with_headings(zpr: dict[str, Any], compass: list[Heading]) -> Columns:
    """The rows of zpr.csv with the headings of a compass.

    Raises
    ------
    GraphError
        A pose with a depth has no heading, or several, or one with a heading has no depth.
    """
    headings = _joined([_measured(h, ("i",), COMPASS[:1]) for h in compass])
    unique, first, count = np.unique(headings["i"], return_index=True, return_counts=True)
    wrong = [*unique[count > 1], *np.setxor1d(unique, zpr["i"])]
    if wrong:
        h = next((h for h in compass if wrong[0] in h.keys[0].numbers), compass[0])
        cure = "one of a large sigma says nothing"
        raise _no_file(h, f"zpr.csv has a depth and a heading for every pose, once: not for x{wrong[0]}; {cure}")
    rows = first[np.searchsorted(unique, zpr["i"])]
    return zpr | {name: headings[name][rows] for name in COMPASS}


def _sonar(sonar: ImagingSonar, mount: Array) -> Columns:
    """The row of sonar.csv."""
    if "\n" in sonar.name:
        raise GraphError(f"write_mission: the name of the sonar, {sonar.name!r}, has more than one line")
    quoted = '"' + sonar.name.replace('"', '""') + '"'
    numbers = [sonar.fan, sonar.aperture, *sonar.window, *mount[:3], *euler.from_se3(mount)[:3]]
    cells: list[Any] = [quoted, sonar.beams, sonar.bins, *map(float, numbers)]
    return {column: [cell] for column, cell in zip(COLUMNS["sonar"], cells, strict=True)}


# --- factors as rows --------------------------------------------------------------------------------------------------


def _no_file(factor: Factor, why: str) -> GraphError:
    """The error of a factor that no file of a mission holds."""
    return GraphError(f"{factor!r} has no file in a mission folder: {why}", factor.keys, factor.name)


def _elements(factor: Factor, size: int) -> Array:
    """Measured elements (n, size), also where all measurements share one."""
    return np.broadcast_to(factor.z.reshape(-1, size), (len(factor), size))


def _standard_deviations(factor: Factor, names: tuple[str, ...]) -> Array:
    """Standard deviations (n, m) of the named components of each measurement.

    Raises
    ------
    GraphError
        The noise has correlations, for which there are no columns.
    """
    noise, shape = factor.noise, (len(factor), len(names))
    noise = noise.noise if isinstance(noise, Robust) else noise
    if isinstance(noise, Isotropic):
        return np.broadcast_to(noise.sigma[:, None], shape)
    if isinstance(noise, Diagonal) and noise.sigmas is not None:
        return np.broadcast_to(noise.sigmas, shape)
    if isinstance(noise, Diagonal):
        return np.stack([np.broadcast_to(noise.named[name], shape[0]) for name in names], axis=1)
    why = f"its noise is {type(noise).__name__}; files hold standard deviations, Diagonal or Isotropic"
    raise _no_file(factor, why)


def _joined(rows: list[Columns]) -> dict[str, npt.NDArray[Any]]:
    """The columns of a table whose rows come in parts."""
    return {column: np.concatenate([np.asarray(row[column]) for row in rows]) for column in rows[0]}


def _table_text(table: str, rows: list[Columns]) -> bytes:
    """The file of a table, without the columns that say nothing: no arm at all, no kernel at all."""
    whole = _joined(rows)
    empty = {*ARM} if not any(np.any(whole[name]) for name in ARM if name in whole) else set()
    empty |= {"kernel"} if "kernel" in whole and np.all(whole["kernel"] == NO_KERNEL) else set()
    names = [name for name in COLUMNS[table] if name in whole and name not in empty]
    return csv_text(names, *(whole[name] for name in names))


def _measured(factor: Factor, ids: tuple[str, ...], names: tuple[str, ...], z: Array | None = None) -> Columns:
    """Columns of a factor: the numbers of its variables by `ids`, what it measures, z (n, m), by `names`, how well."""
    numbers: Columns = {name: keys.numbers for name, keys in zip(ids, factor.keys, strict=True)}
    components = tuple(name.rpartition("_")[0] for name in names)
    z = _elements(factor, factor.sizes()[-1]) if z is None else z
    return numbers | _columns_of(names, z) | _columns_of(suffixed(names), _standard_deviations(factor, components))


def _columns_of(names: tuple[str, ...], numbers: Array) -> Columns:
    """Columns by name of numbers (n, m)."""
    return dict(zip(names, np.broadcast_to(numbers, (len(numbers), len(names))).T, strict=True))


def _positioned(factors: list[Factor]) -> tuple[dict[str, list[Columns]], list[Factor]]:
    """The rows of fixes, beacons, ranges and closures, by these names, and the factors that are of none of them.

    Raises
    ------
    GraphError
        Factors of one table with other columns; noise with correlations; a kernel where there is no column for it.
    """
    tables: dict[str, list[Columns]] = {}
    others: list[Factor] = []
    headings = [factor.keys for factor in factors if isinstance(factor, Heading)]
    for factor in factors:
        kinds = [keys.kind for keys in factor.keys]
        if isinstance(factor, Position) and kinds == ["x"] and factor.keys not in headings:
            if factor.components not in (None, ("x", "y"), ("x", "y", "z")):
                others.append(factor)
                continue
            name, columns = "fixes", _measured(factor, ("i",), PLACE[: factor.z.shape[-1]])
            columns |= _arm(factor, factor.offset)
        elif isinstance(factor, Prior) and kinds == ["b"] and factor.components in (None, ("z",)):
            names = PLACE[2:] if factor.components else PLACE
            name, columns = "beacons", _measured(factor, ("beacon",), names, _elements(factor, 3)[:, -len(names) :])
        elif isinstance(factor, Range) and kinds == ["x", "b"]:
            offset = SE3.identity() if factor.offset is None else np.asarray(factor.offset)
            if (offset[:, 3:] != SE3.identity()[0, 3:]).any():
                raise _no_file(factor, "ranges.csv has no column for the attitude of a sensor on the vehicle")
            name, columns = "ranges", _measured(factor, ("i", "beacon"), ("range_m",)) | _arm(factor, offset[:, :3])
        elif isinstance(factor, Between) and kinds == ["x", "x"] and factor.convention == "log":
            z = euler.from_se3(_elements(factor, SE3.size))
            name, columns = "closures", _measured(factor, ("i", "j"), (*PLACE, *POSE[1:4]), z[:, [3, 4, 5, 0, 1, 2]])
        else:
            others.append(factor)
            continue
        rows = tables.setdefault(name, [])
        if name != "beacons":
            columns["kernel"] = [_kernel(factor)] * len(factor)
        elif factor.kernel is not None:
            raise _no_file(factor, "beacons.csv has no column for a robust kernel")
        if rows and list(rows[0]) != list(columns):
            raise _no_file(factor, f"another factor has other columns of {name}.csv: {', '.join(rows[0])}")
        rows.append(columns)
    if "beacons" in tables and len(np.unique(beacons := _joined(tables["beacons"])["beacon"])) < len(beacons):
        raise GraphError("write_mission: a beacon has two priors, and beacons.csv one row for each")
    return tables, others


def _kernel(factor: Factor) -> str:
    """The robust kernel as text."""
    if factor.kernel is None:
        return NO_KERNEL
    names = {kind: name for name, kind in KERNELS.items()}
    if type(factor.kernel) not in names:
        raise _no_file(factor, f"its kernel is none of {', '.join(KERNELS)}")
    return f"{names[type(factor.kernel)]}:{factor.kernel.c!r}"


def _arm(factor: Factor, offset: Array | None) -> Columns:
    """Lever arms of all rows, 0 where there is none."""
    return _columns_of(ARM, np.broadcast_to(np.zeros((1, 3)) if offset is None else offset, (len(factor), 3)))
