"""Angles of more than a turn are said and read; negative eigenvalues are refused, or repaired when asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.noise import NEGATIVE
from nls import GraphWarning, load
from nls.io.pyfg import read_pyfg
from nls.io.weights import repaired
from tests.combinations import for_all
from tests.nls.io.g2o_files import PLANE, UPPER_3, again, assert_refused, read, same, same_factors, write
from tests.nls.io.io_files import ISAM_3, PYFG, TORO_3

DEGREES = "these degrees?"


def test_degrees_in_an_edge_are_warned_of_and_turns_of_a_vertex_noted() -> None:
    degrees = PLANE.replace("1.01 0.98 1.5", "1.01 0.98 86").replace("0.9 1.5", "0.9 -87")
    graph, _, report = read(degrees.replace("2.1 3.0", "2.1 15.5664"))
    (warning,), (note, _) = report.warnings, report.notes
    assert warning.startswith("2 lines have an angle of more than a turn, first on line 6 (EDGE_SE2): 86")
    assert warning.endswith(DEGREES)
    assert note.startswith("1 line has an angle of more than a turn, first on line 4 (VERTEX_SE2): 15.5664")
    assert graph.factors[0].z[1, 2] == 86  # read as it is
    for angle in ("6.2832", "-6.28", "3.2", "0"):  # up to a turn
        assert read(PLANE.replace("1.01 0.98 1.5", f"1.01 0.98 {angle}"))[2].notes == []


def test_roll_pitch_and_yaw_of_toro_and_poses_of_pyfg() -> None:
    """A prior of pyfg is a measurement, its vertex is none."""
    report = read(TORO_3.replace("0.11 -0.21 0.41", "0.11 -20.5 10.41"))[2]
    assert "first on line 4 (EDGE3): -20.5" in report.warnings[0]
    text = PYFG.replace("A1 1 0 0.1\n", "A1 1 0 90\n") + "VERTEX_SE2:PRIOR 0.5 A0 0 0 45.5 0.01 0 0 0.01 0 0.001\n"
    _, _, report = read_pyfg(text.encode(), "a.pyfg")
    assert [note.split(";")[0].split(", ")[1] for note in (*report.warnings, report.notes[0])] == [
        "first on line 6 (VERTEX_SE2:PRIOR): 45.5",
        "first on line 2 (VERTEX_SE2): 90",
    ]


TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\n"
GOOD = "EDGE_SE2 0 1 1.01 0 0 4 0.5 0.25 3 0.125 2\n"
BAD = "EDGE_SE2 1 2 1.02 0.1 0.3 1 2 0 1 0 1\nEDGE_SE2 0 2 2.1 0 0.1 4 0 0 9 12 4\n"


def smallest(Omega: np.ndarray) -> np.ndarray:
    """Smallest eigenvalue of every matrix scaled to a diagonal of ones."""
    d = np.sqrt(np.abs(np.diagonal(Omega, axis1=1, axis2=2)))
    d = np.where(d > 0, d, 1)
    return np.linalg.eigvalsh(Omega / d[:, :, None] / d[:, None, :])[:, 0]


def test_refused_unless_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, TWO + GOOD + BAD)
    assert_refused(5, "measurement 1 has the negative eigenvalue -1", load, path)
    with pytest.warns(GraphWarning, match="2 information matrices of EDGE_SE2 .* first on line 5"):
        graph, values, report = load(path, repair_information=True)
    assert len(report.notes) == 1
    M = graph.factors[0].noise.matrix  # type: ignore[attr-defined]
    assert np.array_equal(M[0], [[4, 0.5, 0.25], [0.5, 3, 0.125], [0.25, 0.125, 2]])  # what is right stays to the bit
    assert M[1] == pytest.approx(np.array([[1.5, 1.5, 0], [1.5, 1.5, 0], [0, 0, 1]]))  # eigenvalues 3, -1 become 3, 0
    nearest = 1.5 * np.ones((2, 2))  # to 1, 2, 1: 9, 12, 4 with a diagonal of ones
    assert M[2, 1:, 1:] == pytest.approx(nearest * np.outer([3, 2], [3, 2]))
    assert graph.optimize(values).converged
    same((graph, values, report), again((graph, values, report), tmp_path))


def test_what_is_right_is_left_alone_without_a_word() -> None:
    _, _, report = read(TWO + GOOD, repair=True)
    assert report.notes == []
    same(read(TWO + GOOD), read(TWO + GOOD, repair=True))


def test_before_units_and_angles_are_turned(tmp_path: Path) -> None:
    line = ISAM_3.splitlines()[0]
    bad = line.replace(UPPER_3, UPPER_3.replace("600", "-600"))
    assert_refused(1, "negative eigenvalue", read, bad, dialect="toro")
    loaded = read(bad, dialect="toro", repair=True)
    assert "EDGE3 had negative eigenvalues, first on line 1" in loaded[2].warnings[0]
    assert smallest(loaded[0].factors[0].noise.matrix)[0] > -NEGATIVE  # type: ignore[attr-defined]
    same_factors(loaded, again(loaded, tmp_path, dialect="toro"))


@given(st.integers(0, 10**6), st.sampled_from([1, 2, 3, 6]), st.integers(-8, 8))
def test_repaired_is_semi_definite_and_near(seed: int, m: int, spread: int) -> None:
    """Accepted by the noise, and no nearer matrix: the removed part is at right angles to what is left."""
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(20, m, m))
    scale = 10.0 ** (spread * rng.uniform(size=(20, m)))
    Omega = (B + B.mT) * scale[:, :, None] * scale[:, None, :]
    Omega[0] = 0
    Omega[1] = -np.eye(m)
    before = smallest(Omega)
    found, changed = repaired(Omega)
    assert (smallest(found) > -NEGATIVE).all()
    assert np.array_equal(changed, before < -NEGATIVE)
    assert np.array_equal(found[~changed], Omega[~changed])
    d = np.sqrt(np.abs(np.diagonal(Omega, axis1=1, axis2=2)))
    d = np.where(d > 0, d, 1)
    left = found / d[:, :, None] / d[:, None, :]
    removed = left - Omega / d[:, :, None] / d[:, None, :]
    assert np.abs(np.sum(left * removed, axis=(1, 2))).max() < 1e-5 * np.abs(removed).max()


def test_rounding_in_the_scale_of_the_result_is_repaired_too() -> None:
    """A variance that all but vanishes: what is rounding beside 1 is no rounding beside a^2 / 4."""
    a = np.logspace(-9, 0, 200)
    Omega = np.array([[[1.0, b], [b, -1.0]] for b in a.tolist()])
    found, changed = repaired(Omega)
    assert changed.all()
    assert (smallest(found) > -NEGATIVE).all()
    assert np.abs(found[:, 0, 0] - 1).max() < 0.3


@for_all(entries=["1e308 -1.1e308 0 1e308 0 1e-308", "-1e308 0 0 0 1e308 0", "0 1 0 0 0 0", "0 0 0 0 0 -1"])
def test_extreme_matrices(entries: str) -> None:
    text = TWO + GOOD + f"EDGE_SE2 1 2 1 0 0 {entries}\n"
    graph, values, report = read(text, repair=True)
    assert len(report.warnings) == 1
    assert np.isfinite(graph.chi2(values))
