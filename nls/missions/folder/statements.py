"""Factors as the rows of files: columns by their names, or why no file has columns for a factor."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from factors import Between, Diagonal, Heading, Isotropic, Position, Prior, Range
from factors.base import Factor
from factors.robust import KERNELS, Robust
from models import SE3, euler
from models.algebra import Array
from models.errors import GraphError
from nls.missions.folder.columns import ANGLES, ARM, COLUMNS, PLACE, suffixed
from nls.missions.folder.rows import NO_KERNEL
from nls.missions.folder.table import csv_text

__all__ = ["Columns", "measured", "positioned_rows", "table_text"]

Columns = dict[str, npt.ArrayLike]
PLACES = (None, ("x", "y"), ("x", "y", "z"))


def no_file(factor: Factor, why: str) -> GraphError:
    """The error of a factor that no file of a mission holds."""
    return GraphError(f"{factor!r} has no file in a mission folder: {why}", factor.keys, factor.name)


def elements(factor: Factor, size: int) -> Array:
    """Measured elements (n, size), also where all measurements share one."""
    return np.broadcast_to(factor.z.reshape(-1, size), (len(factor), size))


def standard_deviations(factor: Factor, names: tuple[str, ...]) -> Array:
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
    raise no_file(factor, f"its noise is {type(noise).__name__}; files hold standard deviations, Diagonal or Isotropic")


def joined(rows: list[Columns]) -> dict[str, npt.NDArray[Any]]:
    """The columns of a table whose rows come in parts."""
    return {column: np.concatenate([np.asarray(row[column]) for row in rows]) for column in rows[0]}


def table_text(table: str, rows: list[Columns]) -> bytes:
    """The file of a table, without the columns that say nothing."""
    whole = joined(rows)
    names = [name for name in COLUMNS[table] if name in whole and not _says_nothing(name, whole)]
    return csv_text(names, *(whole[name] for name in names))


def measured(factor: Factor, ids: tuple[str, ...], names: tuple[str, ...], z: Array | None = None) -> Columns:
    """Columns of a factor: the numbers of its variables by `ids`, what it measures, z (n, m), by `names`, how well."""
    numbers: Columns = {name: keys.numbers for name, keys in zip(ids, factor.keys, strict=True)}
    components = tuple(name.rpartition("_")[0] for name in names)
    z = elements(factor, factor.sizes()[-1]) if z is None else z
    return numbers | columns_of(names, z) | columns_of(suffixed(names), standard_deviations(factor, components))


def columns_of(names: tuple[str, ...], numbers: Array) -> Columns:
    """Columns by name of numbers (n, m)."""
    return dict(zip(names, np.broadcast_to(numbers, (len(numbers), len(names))).T, strict=True))


def _says_nothing(name: str, whole: dict[str, npt.NDArray[Any]]) -> bool:
    """Whether a column may be left out: no arm at all, no kernel at all."""
    if name == "kernel":
        return bool(np.all(whole[name] == NO_KERNEL))
    return name in ARM and not any(np.any(whole[column]) for column in ARM)


# --- fixes, beacons, ranges and closures ------------------------------------------------------------------------------


def _positioned(factors: list[Factor]) -> dict[int, str]:
    """Which of some factors, by their place, are rows of which of these tables."""
    headings = [factor.keys for factor in factors if isinstance(factor, Heading)]
    out = {}
    for k, factor in enumerate(factors):
        kinds = [keys.kind for keys in factor.keys]
        if isinstance(factor, Position) and kinds == ["x"] and factor.keys not in headings:
            out.update({k: "fixes"} if factor.components in PLACES else {})
        elif isinstance(factor, Prior) and kinds == ["b"] and factor.components in (None, ("z",)):
            out[k] = "beacons"
        elif isinstance(factor, Range) and kinds == ["x", "b"]:
            out[k] = "ranges"
        elif isinstance(factor, Between) and kinds == ["x", "x"] and factor.convention == "log":
            out[k] = "closures"
    return out


def positioned_rows(factors: list[Factor]) -> tuple[dict[str, list[Columns]], list[Factor]]:
    """The rows of these tables, by their names, and the factors that are of none of them.

    Raises
    ------
    GraphError
        Factors of one table with other columns; noise with correlations; a kernel where there is no column for it.
    """
    tables: dict[str, list[Columns]] = {}
    of_tables = _positioned(factors)
    for k, name in of_tables.items():
        columns = ROWS[name](factors[k])
        rows = tables.setdefault(name, [])
        if name != "beacons":
            columns["kernel"] = [_kernel(factors[k])] * len(factors[k])
        elif factors[k].kernel is not None:
            raise no_file(factors[k], "beacons.csv has no column for a robust kernel")
        if rows and list(rows[0]) != list(columns):
            raise no_file(factors[k], f"another factor has other columns of {name}.csv: {', '.join(rows[0])}")
        rows.append(columns)
    if "beacons" in tables and len(np.unique(beacons := joined(tables["beacons"])["beacon"])) < len(beacons):
        raise GraphError("write_mission: a beacon has two priors, and beacons.csv one row for each")
    return tables, [factor for k, factor in enumerate(factors) if k not in of_tables]


def _kernel(factor: Factor) -> str:
    """The robust kernel as text."""
    if factor.kernel is None:
        return NO_KERNEL
    names = {kind: name for name, kind in KERNELS.items()}
    if type(factor.kernel) not in names:
        raise no_file(factor, f"its kernel is none of {', '.join(KERNELS)}")
    return f"{names[type(factor.kernel)]}:{factor.kernel.c!r}"


def _fix(factor: Factor) -> Columns:
    assert isinstance(factor, Position)
    return measured(factor, ("i",), PLACE[: factor.z.shape[-1]]) | _arm(factor, factor.offset)


def _beacon(factor: Factor) -> Columns:
    assert isinstance(factor, Prior)
    names = PLACE[2:] if factor.components else PLACE
    return measured(factor, ("beacon",), names, elements(factor, 3)[:, -len(names) :])


def _range(factor: Factor) -> Columns:
    assert isinstance(factor, Range)
    if factor.offset is not None and (np.asarray(factor.offset)[:, 3:] != SE3.identity()[0, 3:]).any():
        raise no_file(factor, "ranges.csv has no column for the attitude of a sensor on the vehicle")
    offset = None if factor.offset is None else np.asarray(factor.offset)[:, :3]
    return measured(factor, ("i", "beacon"), ("range_m",)) | _arm(factor, offset)


def _closure(factor: Factor) -> Columns:
    z = euler.from_se3(elements(factor, SE3.size))
    return measured(factor, ("i", "j"), (*PLACE, *ANGLES), z[:, [3, 4, 5, 0, 1, 2]])


def _arm(factor: Factor, offset: Array | None) -> Columns:
    """Lever arms of all rows, 0 where there is none."""
    arm = np.zeros((1, 3)) if offset is None else offset
    return columns_of(ARM, np.broadcast_to(arm, (len(factor), 3)))


ROWS = {"fixes": _fix, "beacons": _beacon, "ranges": _range, "closures": _closure}
