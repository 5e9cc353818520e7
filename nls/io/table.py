"""The values of a graph as a table for spreadsheets: one row a variable."""

from __future__ import annotations

import numpy as np

from models import SE3, SO3, Manifold
from models.algebra import Array
from nls.io.report import LoadReport
from nls.values import Stack, Values

__all__ = ["values_table"]

QUATERNION = ("qx", "qy", "qz", "qw")
STORED: dict[Manifold, tuple[str, ...]] = {
    SE3: ("x", "y", "z", *QUATERNION),
    SO3: QUATERNION,
}  # whose stored form is not that of their steps


def values_table(values: Values, report: LoadReport | None = None) -> bytes:
    """CSV with the kind, the number, the time where it is known, and the numbers of every variable, m and rad.

    Columns are those of all kinds together; cells that a kind does not have are empty. Numbers read back bit for bit.

    Examples
    --------
    >>> from models import SE2, R
    >>> from nls import Values, kinds
    >>> x, l = kinds("x", "l")
    >>> print(values_table(Values({x: (SE2, [[1, 2, 0.5]]), l: (R(2), [[3, 4]], [7])})).decode())
    kind,number,x,y,yaw
    x,0,1.0,2.0,0.5
    l,7,3.0,4.0,
    <BLANKLINE>
    """
    times = {} if report is None else report.vertex_times
    columns = dict.fromkeys(name for stack in values.stacks.values() for name in _names(stack.manifold))
    timed = any(kind in times for kind in values.stacks)
    lines = [",".join(["kind", "number", *["time_s"] * timed, *columns])]
    for stack in values.stacks.values():
        lines += _rows(stack, times.get(stack.kind) if timed else None, timed, list(columns))
    return ("\n".join(lines) + "\n").encode()


def _names(manifold: Manifold) -> tuple[str, ...]:
    """Names of the stored numbers."""
    return STORED.get(manifold, manifold.components)


def _rows(stack: Stack, times: Array | None, timed: bool, columns: list[str]) -> list[str]:
    """The lines of one kind."""
    names = _names(stack.manifold)
    cells = np.full((len(stack), len(columns)), "", dtype=object)
    cells[:, [columns.index(name) for name in names]] = [[repr(n) for n in row] for row in stack.X.tolist()] or ""
    time = [[repr(t)] for t in times.tolist()] if times is not None else [[""] * timed] * len(stack)
    return [
        ",".join([stack.kind, str(number), *t, *row])
        for number, t, row in zip(stack.numbers.tolist(), time, cells.tolist(), strict=True)
    ]
