"""The values of a graph, or their covariances, as a table for spreadsheets: one row a variable."""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from factors.keys import Keys
from models import SE3, SO3, Manifold
from models.algebra import Array
from models.errors import OptionError
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.io.files import write_bytes
from nls.io.report import LoadReport
from nls.values import Stack, Values

EMPTY = ("unmeasured", "free")  # what has no covariance
QUATERNION = ("qx", "qy", "qz", "qw")
STORED: dict[Manifold, tuple[str, ...]] = {
    SE3: ("x", "y", "z", *QUATERNION),
    SO3: QUATERNION,
}  # whose stored form is not that of their steps


def values_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """CSV with the kind, the number, the time where it is known, and the numbers of every variable, m and rad.

    Columns are those of all kinds together; cells that a kind does not have are empty. Numbers read back bit for bit.

    Examples
    --------
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> values = Values({x: (SE2, [[1, 2, 0.5]]), l: (R(2), [[3, 4]], [7])})
    >>> print(values_text("values.csv", "csv", FactorGraph(), values, None)[0].decode())
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
        known = stack.kind in times
        time = [[repr(t)] for t in times[stack.kind].tolist()] if known else [[""] * timed] * len(stack)
        lines += _rows(stack, time, _names(stack.manifold), list(columns), stack.X)
    return ("\n".join(lines) + "\n").encode(), []


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
    stacks, pairs = marginals.values.stacks.values(), dict[str, list[str]]()
    for stack in stacks:
        names, axes = stack.manifold.components, frame if stack.manifold.body_axes else "world"
        pairs[stack.kind] = [f"{axes}_{a}_{b}" for k, a in enumerate(names) for b in names[k:]]
    columns = list(dict.fromkeys(name for names in pairs.values() for name in names))
    lines = [",".join(["kind", "number", "status", *columns])]
    for stack in stacks:
        status = marginals.status(stack.kind)
        known = np.array([word not in EMPTY for word in status], dtype=bool)
        Sigma = marginals.covariance(Keys(stack.kind, stack.numbers[known]), frame=frame)
        held = np.isin(stack.manifold.components, list(unmeasured)) & stack.manifold.body_axes
        Sigma[:, held], Sigma[:, :, held] = np.nan, np.nan
        upper = np.full((len(stack), len(pairs[stack.kind])), np.nan)
        upper[known] = Sigma[:, *np.triu_indices(stack.manifold.dim)]
        lines += _rows(stack, [[word] for word in status], pairs[stack.kind], columns, upper)
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _names(manifold: Manifold) -> tuple[str, ...]:
    """Names of the stored numbers."""
    return STORED.get(manifold, manifold.components)


def _rows(
    stack: Stack, words: Sequence[Sequence[str]], names: Sequence[str], columns: list[str], numbers: Array
) -> list[str]:
    """The lines of one kind: some words (n, k), then the numbers (n, m) with these names; cells of nan are empty."""
    cells = np.full((len(stack), len(columns)), "", dtype=object)
    written = [["" if np.isnan(number) else repr(number) for number in row] for row in numbers.tolist()]
    cells[:, [columns.index(name) for name in names]] = written or ""
    return [
        ",".join([stack.kind, str(number), *word, *row])
        for number, word, row in zip(stack.numbers.tolist(), words, cells.tolist(), strict=True)
    ]
