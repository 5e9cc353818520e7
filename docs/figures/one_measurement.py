"""One relative pose on its way through the library, from the line of its file to the step: sixteen files, top down.

The calls are recorded while a file of one edge is read and optimized, so the picture shows the code as it is.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import nls
from nls import Kind
from nls.plot.style import BEFORE, ELLIPSE, ESTIMATE, LANDMARK, REJECTED, SIGHT

EDGE = "EDGE_SE2 0 1  1 0 0  100 0 0 100 0 400"
FILE = f"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0.9 0.1 0\n{EDGE}\n"
ROOMS = {"nls/io": SIGHT, "factors": LANDMARK, "models": REJECTED, "nls/sparse": ESTIMATE, "nls/linear": BEFORE}
REST = ELLIPSE  # of what a user touches, and the optimizers


def walk(numbers: dict[str, str]) -> list[tuple[str, str, str]]:
    """File, function, and what is known when it returns."""
    return [
        ("nls/io/text.py", "Text.table", EDGE),
        ("nls/io/records.py", "Record.build", "Between(x0, x1, z, Information), z = (1 m, 0 m, 0 rad)"),
        ("factors/base.py", "Factor.bind", "both ends are in SE(2); whitener W = diag(10, 10, 20)"),
        ("nls/graph.py", "FactorGraph.optimize", "a graph of one factor, values of two poses"),
        ("nls/sparse/pattern.py", "Pattern.__init__", "its rows of A: 0, 1, 2; its variables: x0, x1"),
        ("nls/gauge.py", "choose_gauge", "x0 is fixed; x1 has the columns 0, 1, 2"),
        (
            "nls/sparse/elimination.py",
            "Elimination.__init__",
            "the order of the variables, from the pairs that share a factor",
        ),
        ("nls/sparse/hessian.py", "Hessian.__init__", "where every number of A'A is in the array of its blocks"),
        ("nls/system.py", "LinearSystem.at", "the values of x0 and x1, gathered"),
        ("factors/between.py", "Between.innovation", f"z - h in the tangent space: {numbers['xi']}"),
        ("models/manifolds/se2.py", "PosesOfThePlane.misfit", f"h = x0^-1 x1 = {numbers['h']}, and the Jacobians"),
        ("factors/noise.py", "whiten", f"A = {numbers['A']} on x1, b = {numbers['b']}"),
        ("nls/optimizers/gauss_newton.py", "GaussNewton.iterate", "the system A dx = b"),
        ("nls/sparse/hessian.py", "Blocks.fill", f"A'A: the block {numbers['H']} of x1"),
        ("nls/linear/factorization.py", "Factorization.factorize", "A'A = L L', no pivot vanishes"),
        ("nls/linear/cholesky.py", "Cholmod.solve", f"dx = {numbers['dx']}"),
        ("nls/values.py", "Values.retract", f"x1 = {numbers['x1']}"),
    ]


def calls(work: Callable[[], Any]) -> list[tuple[str, str]]:
    """File and function of every call into the packages, in order."""
    root, seen = Path(nls.__file__).parents[1], list[tuple[str, str]]()

    def note(frame: FrameType, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(root):
            seen.append((path.relative_to(root).as_posix(), frame.f_code.co_qualname))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return seen


def make() -> tuple[list[Figure], list[float]]:
    """The picture."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.g2o"
        path.write_text(FILE)
        solver = nls.Cholesky() if nls.Cholesky.missing() is None else nls.LU()
        once = nls.GaussNewton(nls.Stop(max_iterations=1))

        def work() -> nls.Result:
            graph, values, _ = nls.load(path)
            return graph.optimize(values, once, solver)

        result = work()  # everything is imported now
        called = calls(work)
        graph, values, _ = nls.load(path)
    x = Kind("x")
    graph.fix(x[0])
    system = graph.linearize(values)
    A, b = system
    numbers = {
        "h": _text(values[x[1]]),
        "xi": _text(b / np.diag(A.toarray())),
        "A": f"diag{_text(np.diag(A.toarray()))}",
        "b": _text(b),
        "H": f"diag{_text(np.diag(system.H.toarray()))}",
        "dx": _text(nls.gauss_newton_step(system)),
        "x1": _text(result.values[x[1]]),
    }
    stations = walk(numbers)
    assert np.allclose(A.toarray(), np.diag(np.diag(A.toarray())))
    assert np.allclose(b, [1.0, -1.0, 0.0])
    if solver.name == "cholesky":
        first = [called.index((file, function)) for file, function, _ in stations]
        assert first == sorted(first), "the walk has changed: draw it anew"
    return [_drawn(stations)], [1.0]


def _text(v: np.ndarray) -> str:
    return "(" + ", ".join(f"{c + 0.0:.3g}" for c in np.round(v, 9)) + ")"


def _drawn(stations: list[tuple[str, str, str]]) -> Figure:
    figure = Figure(figsize=(10.5, 8.6), layout="constrained")
    axes = figure.subplots()
    n = len(stations)
    axes.set(xlim=(0, 10.5), ylim=(-0.6, n - 0.4))
    axes.axis("off")
    axes.plot([0.3, 0.3], [0, n - 1], color="0.8", linewidth=2, zorder=0)
    for k, (file, function, known) in enumerate(stations):
        y = n - 1 - k
        color = next((color for room, color in ROOMS.items() if file.startswith(room + "/")), REST)
        axes.plot(0.3, y, "o", color=color, markersize=15)
        axes.text(0.3, y, str(k + 1), color="white", ha="center", va="center", fontsize=9)
        axes.text(0.65, y + 0.14, file, color=color, va="center", fontsize=11, family="monospace", weight="bold")
        axes.text(0.65, y - 0.24, function, color="0.4", va="center", fontsize=9, family="monospace")
        axes.text(4.7, y, known, va="center", fontsize=10.5)
    return figure
