"""CEP and 2DRMS: of normal errors the factors of the textbook; a third column does not count."""

from __future__ import annotations

import numpy as np
import pytest

from nls import GraphError, OptionError
from nls.metrics import cep, drms2


def test_normal_errors() -> None:
    errors = np.random.default_rng(0).normal(size=(200_000, 3)) * [2.0, 2.0, 50.0]
    circles = [cep(errors), cep(errors, 0.95), drms2(errors)]
    assert circles == pytest.approx([2 * 1.1774, 2 * 2.4477, 2 * np.sqrt(8)], rel=0.01)
    assert [cep(errors[:, :2]), drms2(errors[:, :2])] == [circles[0], circles[2]]
    inside = np.mean(np.hypot(errors[:, 0], errors[:, 1]) < circles[2])
    assert inside == pytest.approx(0.982, abs=0.002)


def test_mistakes() -> None:
    for errors in ([1.0], np.zeros((0, 2)), np.zeros((2, 7))):
        with pytest.raises(GraphError, match=r"expected \(n, 2\) or \(n, 3\)"):
            cep(errors)
    with pytest.raises(GraphError, match="not finite"):
        drms2([[np.nan, 0.0]])
    with pytest.raises(OptionError, match="between 0 and 1"):
        cep([[1.0, 0.0]], 95)
