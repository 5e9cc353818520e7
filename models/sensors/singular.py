"""Refusing a geometry in which a sensor's equation has no value, with the element of the batch it is in."""

from __future__ import annotations

import numpy as np

from models.algebra import Mask
from models.errors import SingularGeometryError

__all__ = ["CLOSE", "SingularAt"]

CLOSE = 1e-9  # m; coordinates of 1 km are rounded to 1e-13 m: nearer than this the digits of a direction are noise


class SingularAt(SingularGeometryError):
    """A singular geometry of one element of a stack; factors add which measurement and variables that is.

    Parameters
    ----------
    message : the singularity and its cure.
    index : the element of the stack.
    """

    def __init__(self, message: str, index: int) -> None:
        self.index = index
        super().__init__(message)


def refuse(bad: Mask, message: str) -> None:
    """Raise `SingularAt` for the first True of bad (n,)."""
    if bad.any():
        raise SingularAt(message, int(np.argmax(bad)))
