"""The columns of matches: a row for each, in their order, also without any."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from nls.missions.scans.matches import Fits
from nls.missions.scans.matching import Match


def test_a_row_for_each_match() -> None:
    rng = np.random.default_rng(1)
    matches = [
        Match(rng.normal(size=3), np.diag(rng.uniform(0.01, 1.0, 3)), *rng.uniform(0.5, 3.0, 3).tolist())
        for _ in range(5)
    ]
    fits = Fits.of(matches)
    for k, match in enumerate(matches):
        for column in fields(Fits):
            np.testing.assert_array_equal(getattr(fits, column.name)[k], getattr(match, column.name), column.name)


def test_no_match() -> None:
    shapes = [getattr(Fits.of([]), column.name).shape for column in fields(Fits)]
    assert shapes == [(0, 3), (0, 3, 3), (0,), (0,), (0,), (0,)]
