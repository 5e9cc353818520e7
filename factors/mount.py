"""Where a sensor sits on the vehicle: checks of poses, points and offsets that several factors share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.constants import constant
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold
from models.algebra import Array
from models.errors import GraphError, SingularGeometryError
from models.sensors import SingularAt

__all__ = ["named_singularity"]


def fixed_offset(factor: Factor, offset: npt.ArrayLike) -> Array:
    """An offset as a read-only copy (n or 1, size); its size is checked when the factor is bound.

    Raises
    ------
    GraphError
        No array of numbers.
    """
    return np.atleast_2d(constant(factor, "offset", offset))


def check_offset(
    factor: Factor, offset: Array | Keys | None, space: Manifold, manifold: Manifold | None = None
) -> None:
    """Refuse an offset that is not an element of a space, one for all measurements or one for each.

    Parameters
    ----------
    factor : for the message.
    offset : fixed array, variable, or None.
    space : what it has to be in.
    manifold : the space of the variable.

    Raises
    ------
    GraphError
    """
    if isinstance(offset, Keys):
        if manifold is not space:
            raise factor._refusal(f"the offset {offset[[0]]} is in {manifold}, expected {space} like the pose")
    elif offset is not None:
        try:
            space.stack(offset)
        except GraphError as error:
            raise factor._refusal(f"offset: {error}") from error
        if len(offset) not in (1, len(factor)):
            raise factor._refusal(f"{len(offset)} offsets for {len(factor)} measurements; give one, or one for each")


def pose_group(factor: Factor, manifold: Manifold, hint: str = "") -> LieGroup:
    """The space of the first variable as a group of poses.

    Raises
    ------
    GraphError
        Neither SE2 nor SE3.
    """
    if manifold is not SE2 and manifold is not SE3:
        raise factor._refusal(f"{factor.keys[0][[0]]} is in {manifold}, expected a pose, SE2 or SE3{hint}")
    assert isinstance(manifold, LieGroup)
    return manifold


@contextmanager
def named_singularity(factor: Factor) -> Iterator[None]:
    """Say which measurement of the factor a singular geometry belongs to."""
    try:
        yield
    except SingularAt as error:
        keys = [k[[error.index]] for k in factor.keys]
        raise SingularGeometryError(f"{factor.describe(error.index)}: {error}", factor.name, keys) from error
