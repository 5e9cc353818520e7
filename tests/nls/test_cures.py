"""A cure never asks for the option that is in use, and a measurement without information is named with its line."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Between, Factor, Huber, Information, Isotropic, Prior
from models import SE2, R
from nls import FactorGraph, UnderconstrainedError, Values, kinds
from nls.cli import main
from nls.linear import SOLVERS, truncated_inverse
from nls.optimizers import OPTIMIZERS, Automatic

x, l = kinds("x", "l")
SE3_ZERO = (
    "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\nVERTEX_SE3:QUAT 2 2 0 0 0 0 0 1\n"
    "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n"
    "EDGE_SE3:QUAT 1 2 1 0 0 0 0 0 1 " + "0 " * 20 + "0\n"
)


def flat(X: np.ndarray) -> np.ndarray:
    """Zero slope at the start: what a damped method may leave, an undamped one not."""
    return np.concatenate([X**2 + 1, X - X], axis=1)


def failing() -> dict[str, tuple[FactorGraph, Values]]:
    """Graphs that leave something free, or whose weights differ too much for A'A."""
    chain = [Between(x[0:3], x[1:4], np.tile([1.0, 0, 0], (3, 1)), Isotropic(0.1))]
    poses = Values({x: (SE2, SE2.identity(4))})
    part = Prior(l[0], [1.0, 0.0], Isotropic(1.0), components=("x",))
    apart = [Prior(l[0], [0.0], Isotropic(1.0)), Between(l[0], l[1], [1.0], Isotropic(1e-8))]
    silent = Between(x[0], x[1], [1.0, 0, 0], Information(np.zeros((3, 3))))
    point = Values({l: (R(2), [[0.0, 0.0]])})
    return {
        "gauge": (FactorGraph(chain), poses),
        "flat": (FactorGraph([Factor.from_function(flat, l[0], 4)]), point),
        "rows": (FactorGraph([part]), point),
        "weights": (FactorGraph(apart), Values({l: (R(1), [0.0, 0.0])})),
        "silent": (FactorGraph([silent]), Values({x: (SE2, SE2.identity(2))})),
        "kernel": (FactorGraph(chain).robust(Huber(1.0)), poses),
    }


SOLVER = {name: kind for name, kind in SOLVERS.items() if kind.missing() is None}
METHODS = {**OPTIMIZERS, "auto": Automatic}


@pytest.mark.parametrize("case", failing())
def test_no_cure_asks_for_what_is_in_use(case: str) -> None:
    graph, values = failing()[case]
    refused = 0
    for (method, kind), solver, gauge in product(METHODS.items(), (*SOLVER, "truncated"), ("none", "first")):
        linear = nls.Schur(block_inverse=truncated_inverse) if solver == "truncated" else SOLVER[solver]()
        try:
            graph.optimize(values, kind(), linear, gauge)
        except (UnderconstrainedError, nls.EvaluationError) as error:
            refused += 1
            text = str(error)
            assert not (method == "levenberg-marquardt" and "LevenbergMarquardt()" in text)
            assert not (solver in ("qr", "dense-qr", "pinv") and "nls.QR()" in text)
            assert not (solver == "truncated" and "truncated_inverse" in text)
            assert not (gauge == "first" and "gauge='first'" in text)
    assert refused or case in ("gauge", "kernel", "weights")


def test_others_still_offer_them() -> None:
    graph, values = failing()["gauge"]
    for solver in (None, nls.DenseQR()):
        with pytest.raises(UnderconstrainedError, match="gauge='first'"):
            graph.optimize(values, nls.GaussNewton(), solver, gauge="none")
    graph, values = failing()["weights"]
    with pytest.raises(UnderconstrainedError, match=r"keep twice the digits: linear_solver=nls.QR\(\)"):
        nls.gauss_newton_step(graph.linearize(values))
    assert np.isfinite(nls.gauss_newton_step(graph.linearize(values), nls.DenseQR())).all()
    with pytest.raises(nls.OptionError, match=r"expected a LinearSystem, graph.linearize\(values\)$"):
        nls.gauss_newton_step(graph, values)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["levenberg-marquardt", "dogleg", "gauss-newton", None])
def test_a_line_without_information_is_named(
    method: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "zero.g2o"
    file.write_text(SE3_ZERO)
    arguments = ["solve", str(file), "--gauge", "first", "--init", "file", *(["--method", method] if method else [])]
    assert main(arguments) == 1
    message = capsys.readouterr().err
    assert re.search(rf"{file}:5: 6 unknowns are not measured: x2: .*; cause: Between\(x1, x2\) has an", message)
    assert f"--method {method}" not in message
    assert "--gauge first" not in message
