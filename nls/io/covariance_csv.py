"""Marginal covariances as a table, one row a variable: what ``nls solve --covariance OUT.csv`` writes."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from factors.keys import Keys
from models.errors import OptionError
from nls.covariance import Marginals
from nls.io.files import write_bytes

__all__ = ["write_covariances"]

EMPTY = ("unmeasured", "free")  # what has no covariance


def write_covariances(
    path: str | Path, marginals: Marginals, frame: str = "world", unmeasured: Collection[str] = ()
) -> None:
    """Write the marginal covariance of every variable as CSV; numbers read back bit for bit.

    The first line names the columns:

    ``kind``, ``number``
        The variable: ``x``, ``17``. Rows come in the order of the values.
    ``status``
        ``estimated``; ``gauge`` or ``fixed``: held, its covariance is zero; ``unmeasured``: it has none, ``free``: it
        has none in some direction; the row ends here with empty cells.
    ``world_x_x``, ``world_x_y``, ... or ``body_x_x``, ...
        The upper triangle row by row. A name says the axes and the two components. ``world_x_yaw`` is the covariance of
        the position error along the x axis of the world and the yaw error. m^2, m rad and rad^2. Columns are those of
        all kinds together; cells that a kind does not have are empty. With ``body`` only what has a body is written
        along its axes: points keep ``world``.

    Parameters
    ----------
    path : the file; gzip-compressed where the name ends in ``.gz``. Written whole or not at all.
    marginals : covariances of a graph.
    frame : ``world`` or ``body``, see `Marginals`.
    unmeasured : components of poses that are held as nothing measures them, such as ``yaw``: their cells are empty.

    Raises
    ------
    OptionError
        Another frame.
    GraphFileError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from factors import Isotropic, Prior
    >>> from models import R
    >>> from nls import FactorGraph, Marginals, Values, kinds
    >>> (l,) = kinds("l")
    >>> graph = FactorGraph([Prior(l[7], [1.0, 2.0], Isotropic(0.5))])
    >>> marginals = Marginals(graph, Values({l: (R(2), [[1.0, 2.0]], [7])}))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_covariances(Path(folder, "points.csv"), marginals)
    ...     print(Path(folder, "points.csv").read_text())
    kind,number,status,world_x_x,world_x_y,world_y_y
    l,7,estimated,0.25,0.0,0.25
    """
    if frame not in ("world", "body"):
        raise OptionError("frame", frame, "'world' or 'body'")
    stacks = marginals.values.stacks.values()
    columns: dict[str, None] = {}
    of_kind: dict[str, list[str]] = {}
    for stack in stacks:
        names, axes = stack.manifold.components, frame if stack.manifold.body_axes else "world"
        of_kind[stack.kind] = [f"{axes}_{a}_{b}" for k, a in enumerate(names) for b in names[k:]]
        columns |= dict.fromkeys(of_kind[stack.kind])
    place = {name: k for k, name in enumerate(columns)}
    lines = [",".join(["kind", "number", "status", *columns])]
    for stack in stacks:
        status = marginals.status(stack.kind)
        known = np.array([word not in EMPTY for word in status], dtype=bool)
        Sigma = marginals.covariance(Keys(stack.kind, stack.numbers[known]), frame=frame)
        held = np.isin(stack.manifold.components, list(unmeasured)) & stack.manifold.body_axes
        Sigma[:, held], Sigma[:, :, held] = np.nan, np.nan
        upper = iter(Sigma[:, *np.triu_indices(stack.manifold.dim)].tolist())
        cells = np.array([place[name] for name in of_kind[stack.kind]], dtype=np.intp).tolist()
        for number, word in zip(stack.numbers.tolist(), status, strict=True):
            row = [""] * len(columns)
            if word not in EMPTY:
                for cell, value in zip(cells, next(upper), strict=True):
                    row[cell] = "" if np.isnan(value) else repr(value)
            lines.append(",".join([stack.kind, str(number), word, *row]))
    write_bytes(path, ("\n".join(lines) + "\n").encode())
