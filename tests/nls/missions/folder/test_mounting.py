"""A mission whose sonar is mounted as a variable: the example of the page on sonar, and elevations seen from there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Diagonal, Elevation, Isotropic, Prior, RangeAzimuth, Sighting
from factors.keys import Keys
from models import SE3
from nls.missions import elevations
from tests.nls.missions.folder.mission_files import TINY, folder

x, l, o = nls.kinds("x", "l", "o")
PAGE = Path(__file__).parents[4] / "docs" / "theory" / "sonar.md"


def test_the_example_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(import nls\n.*?)```", PAGE.read_text(), re.DOTALL)
    folder(tmp_path / "survey")
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    said = re.fullmatch(r"pitch (.*) deg from sonar.csv, known to (.*) deg\n", capsys.readouterr().out)
    away, sigma = map(float, said.groups())
    assert 0 < sigma < np.degrees(0.1)  # more than was known before
    assert 0 < abs(away) < 3 * sigma


def mounted(graph: nls.FactorGraph, values: nls.Values, offset: Keys | np.ndarray) -> nls.FactorGraph:
    return nls.FactorGraph([f.mounted(offset) if isinstance(f, Sighting) else f for f in graph.factors])


def test_elevations_seen_from_a_mounting_that_is_a_variable(tmp_path: Path) -> None:
    """All but known it is the fixed one; less well known, elevations are less well known."""
    graph, values, report = nls.load(folder(tmp_path / "m"))
    fixed = graph.optimize(values).values
    expected = elevations(graph, fixed, sigmas=True)
    values.add(o, SE3, report.offset)
    free = mounted(graph, values, o[0])
    sigmas = {}
    for sigma in (1e-6, 0.1):
        known = nls.FactorGraph([*free.factors, Prior(o[0], report.offset, Diagonal([1e-6] * 4 + [sigma, 1e-6]))])
        solved = known.optimize(values).values
        found = elevations(known, solved, sigmas=True)
        sigmas[sigma] = found.sigma
        if sigma < 1e-3:
            for name in ("landmarks", "poses", "views", "range", "azimuth", "elevation", "along"):
                np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=1e-5)
            np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-4)
    assert (sigmas[0.1] > 1.01 * sigmas[1e-6]).all()
    marginals = nls.Marginals(known, solved)  # H Sigma H' over pose, landmark and mounting
    for k, (pose, landmark) in enumerate(zip(found.poses.tolist(), found.landmarks.tolist(), strict=True)):
        model, X = solved.gather(Elevation(x[pose], l[landmark], 0.0, Isotropic(1.0), o[0]))
        H = np.hstack([A[0] for A in model.linearize(*X)[0]])
        Sigma = marginals.joint([x[pose], l[landmark], o[0]], frame="body").matrix
        assert found.before[k] == pytest.approx(float(np.sqrt((H @ Sigma @ H.T)[0, 0])), rel=1e-4)


def test_contacts_in_several_factors_with_mountings_of_their_own(tmp_path: Path) -> None:
    graph, values, report = nls.load(folder(tmp_path / "m", contacts=TINY["contacts"]))
    fixed = graph.optimize(values).values
    expected = elevations(graph, fixed)
    (contacts,) = [f for f in graph.factors if isinstance(f, RangeAzimuth)]
    rest = [f for f in graph.factors if f is not contacts]
    odd = np.arange(len(contacts)) % 2 == 1
    assert {int(k) for k in contacts.keys[1].numbers[:3][odd[:3]]} == {12}
    parts = [contacts[odd], contacts[~odd].mounted(np.tile(report.offset, ((~odd).sum(), 1)))]
    found = elevations(nls.FactorGraph([*rest, *parts]), fixed)
    for name in ("landmarks", "poses", "range", "azimuth", "elevation", "along"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    turned = SE3.retract(report.offset[None], np.array([[0.0, 0, 0, 0, 0.2, 0]]))
    found = elevations(nls.FactorGraph([*rest, parts[0], contacts[~odd].mounted(turned)]), fixed)
    away = np.abs(found.elevation - expected.elevation)
    assert (away[found.landmarks != 12] > 0.1).all()  # only 12 is first seen by the other factor
    assert away[found.landmarks == 12] == pytest.approx(0.0, abs=1e-12)
