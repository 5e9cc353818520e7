"""Fixes, beacons, ranges and closures of a graph as the tables that `read_mission` makes these factors of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import Between, Heading, Position, Prior, Range
from factors.base import Factor
from factors.robust import KERNELS
from models import SE3, euler
from models.algebra import Array, Numbers
from models.errors import GraphError
from nls.io.mission.columns import ANGLES, ARM, COLUMNS, PLACE, suffixed
from nls.io.mission.rows import NO_KERNEL
from nls.io.mission.statements import measured_numbers, no_file, standard_deviations
from nls.io.mission.table import csv_text

__all__ = ["positioned", "positioned_files", "positioned_poses"]

Columns = dict[str, npt.ArrayLike]
PLACES = (None, ("x", "y"), ("x", "y", "z"))


def positioned(factors: list[Factor]) -> dict[int, str]:
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


def positioned_files(factors: list[Factor]) -> dict[str, bytes]:
    """The tables of these factors, by the names of their files.

    Raises
    ------
    GraphError
        Factors of one table with other columns; noise with correlations; a kernel where there is no column for it.
    """
    tables: dict[str, list[Columns]] = {}
    for k, name in positioned(factors).items():
        columns = ROWS[name](factors[k])
        rows = tables.setdefault(name, [])
        if name != "beacons":
            columns["kernel"] = [_kernel(factors[k])] * len(factors[k])
        elif factors[k].kernel is not None:
            raise no_file(factors[k], "beacons.csv has no column for a robust kernel")
        if rows and list(rows[0]) != list(columns):
            raise no_file(factors[k], f"another factor has other columns of {name}.csv: {', '.join(rows[0])}")
        rows.append(columns)
    out = {}
    for name, rows in tables.items():
        whole = {column: np.concatenate([np.asarray(row[column]) for row in rows]) for column in rows[0]}
        if name == "beacons" and len(np.unique(whole["beacon"])) < len(whole["beacon"]):
            raise GraphError("write_mission: a beacon has two priors, and beacons.csv one row for each")
        names = [n for n in COLUMNS[name] if n in whole and not _says_nothing(n, whole)]
        out[f"{name}.csv"] = csv_text(names, *(whole[n] for n in names))
    return out


def positioned_poses(factors: list[Factor]) -> dict[str, Numbers]:
    """Numbers of the poses in each of these tables."""
    out: dict[str, list[Numbers]] = {}
    for k, name in positioned(factors).items():
        out.setdefault(name, []).extend(keys.numbers for keys in factors[k].keys if keys.kind == "x")
    return {name: np.concatenate(numbers) for name, numbers in out.items() if numbers}


def _says_nothing(name: str, whole: dict[str, npt.NDArray[np.generic]]) -> bool:
    """Whether a column may be left out: no arm at all, no kernel at all."""
    if name == "kernel":
        return bool(np.all(whole[name] == NO_KERNEL))
    return name in ARM and not any(np.any(whole[column]) for column in ARM)


def _kernel(factor: Factor) -> str:
    """The robust kernel as text."""
    if factor.kernel is None:
        return NO_KERNEL
    names = {kind: name for name, kind in KERNELS.items()}
    if type(factor.kernel) not in names:
        raise no_file(factor, f"its kernel is none of {', '.join(KERNELS)}")
    return f"{names[type(factor.kernel)]}:{factor.kernel.c!r}"


def _columns(names: tuple[str, ...], numbers: Array) -> Columns:
    return dict(zip(names, np.broadcast_to(numbers, (len(numbers), len(names))).T, strict=True))


def _fix(factor: Factor) -> Columns:
    assert isinstance(factor, Position)
    z = measured_numbers(factor)
    names = PLACE[: z.shape[1]]
    sigmas = standard_deviations(factor, ("x", "y", "z")[: z.shape[1]])
    return {
        "i": factor.keys[0].numbers,
        **_columns(names, z),
        **_columns(suffixed(names), sigmas),
        **_arm(factor, factor.offset),
    }


def _beacon(factor: Factor) -> Columns:
    assert isinstance(factor, Prior)
    names = PLACE[2:] if factor.components else PLACE
    z = np.broadcast_to(factor.z.reshape(-1, 3), (len(factor), 3))[:, 3 - len(names) :]
    sigmas = standard_deviations(factor, ("x", "y", "z")[3 - len(names) :])
    return {"beacon": factor.keys[0].numbers, **_columns(names, z), **_columns(suffixed(names), sigmas)}


def _range(factor: Factor) -> Columns:
    assert isinstance(factor, Range)
    if factor.offset is not None and (np.asarray(factor.offset)[:, 3:] != SE3.identity()[0, 3:]).any():
        raise no_file(factor, "ranges.csv has no column for the attitude of a sensor on the vehicle")
    offset = None if factor.offset is None else np.asarray(factor.offset)[:, :3]
    return {
        "i": factor.keys[0].numbers,
        "beacon": factor.keys[1].numbers,
        "range_m": measured_numbers(factor)[:, 0],
        "sigma_range_m": standard_deviations(factor, ("range",))[:, 0],
        **_arm(factor, offset),
    }


def _closure(factor: Factor) -> Columns:
    names = (*PLACE, *ANGLES)
    z = euler.from_se3(np.broadcast_to(factor.z.reshape(-1, SE3.size), (len(factor), SE3.size)))
    sigmas = standard_deviations(factor, SE3.components)
    i, j = (keys.numbers for keys in factor.keys)
    return {"i": i, "j": j, **_columns(names, z[:, [3, 4, 5, 0, 1, 2]]), **_columns(suffixed(names), sigmas)}


def _arm(factor: Factor, offset: Array | None) -> Columns:
    """Lever arms of all rows, 0 where there is none."""
    arm = np.zeros((1, 3)) if offset is None else offset
    return _columns(ARM, np.broadcast_to(arm, (len(factor), 3)))


ROWS = {"fixes": _fix, "beacons": _beacon, "ranges": _range, "closures": _closure}
