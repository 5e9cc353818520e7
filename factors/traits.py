"""Uses of a factor, stated by the factor. Starts and analyses ask for its use, never for its type.

The model in each method is the factor bound to the spaces of its variables, `factors.base.Model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from factors.noise_size import numbers_of_z
from models import Manifold, R
from models.algebra import Array

__all__ = ["Traits"]


class Traits:
    """The uses of a factor, none by default; `Sighting` has those of a sensor that sees targets.

    Attributes
    ----------
    frame : whose axes the components x, y, z and yaw of z are along. ``world`` of one variable, ``first`` of the second
        variable as seen from the first, ``sensor`` of a target. Empty where no other reading of z makes sense.
    sequential : True when its relative poses are of one stretch of the way, whatever their numbers: no loop closures.
    opaque : True when a function of the user's alone knows its data: it cannot be sliced.
    along_world : True when it measures along the axes of the world where its first variable is a point.
    """

    frame: ClassVar[str] = ""
    sequential: ClassVar[bool] = False
    opaque: ClassVar[bool] = False
    along_world: bool = False

    def __str__(self) -> str:
        """The variables of a factor, as in messages, and its numbers.

        Examples
        --------
        >>> from factors import Between, Diagonal
        >>> from nls import kinds
        >>> (x,) = kinds("x")
        >>> print(Between(x[0], x[1], [1.0, 0.0, 0.5], Diagonal(x=0.1, y=0.1, yaw=0.02)))
        Between(x0, x1): z = [1. , 0. , 0.5], Diagonal(x=0.1, y=0.1, yaw=0.02)
        """
        factor: Any = self
        z = np.array2string(factor.z, precision=6, threshold=12, edgeitems=2, separator=", ")
        return f"{factor!r}: z = {' '.join(z.split())}, {factor.noise!r}"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """The text that IPython and Jupyter show."""
        printer.text(str(self))

    def knows_axes(self, manifolds: tuple[Manifold | None, ...]) -> bool:
        """Whether a turn of everything changes its residual, though a shift does not, for variables in these spaces."""
        return self.along_world and manifolds[0] in (R(2), R(3))

    def relative_poses(self, model: Any) -> Array | None:
        """Poses (n, size) of the second variable in the first, of odometry and of matches; None of others."""
        return None

    def relinearize(self, model: Any, X: Sequence[Array], A: Array) -> Array | None:
        """Write whitened Jacobians over those at other values, A (n, m, D) side by side; e = z [-] h(X) (n, dim).

        None, with nothing written, where that is no faster than `Factor.innovation`.
        """
        return None

    def level_steps(self, model: Any) -> Array | None:
        """Steps (n, 3) to the second pose in the horizontal axes of the first: x, y, m, and yaw; None of others."""
        return None

    def tilts(self, model: Any) -> Array | None:
        """z, m, pitch and roll (n, 3) of the first variable, a pose in SE3; None of other measurements."""
        return None

    def noise_sizes(self) -> tuple[int, ...]:
        """How many numbers its noise may be for, as far as that is known when it is made; () for any."""
        factor: Any = self
        return numbers_of_z(factor) if factor.sizes() else ()

    def states(self, trait: str) -> bool:
        """Whether its class implements a trait, such as ``relative_poses``, of which the default says nothing."""
        default = next(vars(base)[trait] for base in reversed(type(self).__mro__) if trait in vars(base))
        return getattr(type(self), trait) is not default
