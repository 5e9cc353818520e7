"""A format of a user: the heights of places and their differences, a line each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors import Between, Isotropic
from models import R
from nls import FactorGraph, Kind, LoadReport, Values

h = Kind("h")


def read_toy(data: bytes, path: str) -> tuple[FactorGraph, Values, LoadReport]:
    """Heights are values, differences are measurements of sigma 1."""
    rows = np.loadtxt(data.decode().splitlines()[1:], ndmin=2)
    steps = Between(h[: len(rows) - 1], h[1 : len(rows)], rows[1:, 1:], Isotropic(1.0))
    return FactorGraph([steps]), Values({h: (R(1), rows[:, :1])}), LoadReport(path, "toy", "1-D", "none")


def toy_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """One row a height, with its difference to the one before."""
    differences = np.vstack([np.zeros((1, 1)), *(factor.z for factor in graph.factors)])
    lines = [f"{a!r} {b!r}\n" for a, b in np.hstack([values[h], differences]).tolist()]
    return "".join([f"{form}\n", *lines]).encode(), ["a toy file holds no sigmas"]
