"""A factor whose Jacobians have the wrong sign: what a user's mistake looks like."""

from __future__ import annotations

import numpy as np

from factors import Between
from factors.base import Jacobians
from models import Manifold
from models.algebra import Array


class WrongSign(Between):
    """Between, with both Jacobians negated."""

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        h, H = super().predict(manifolds, *X)
        assert H is not None
        assert H[0] is not None
        return h, (-H[0], -np.eye(manifolds[0].dim)[None])
