r"""The residual of a measurement that lives on a group: four conventions, chosen by name.

A convention gives the innovation e and the matrix J with e(h Exp(xi)) = e - J xi + O(xi^2), h the prediction:

    log, gtsam   E = h^-1 z,   e = Log E,       J = J_l^-1(e)
    graphslam    E = h^-1 z,   e = vector(E),   J = d vector(Exp(d) E) / dd
    g2o          E = z^-1 h,   e = -vector(E),  J = d vector(E Exp(d)) / dd

vector(E) is the translation and the wrapped angle (plane) or quaternion vector part (space), `LieGroup.vector`. `log`
and `gtsam` are the same residual; they differ in how the information of a *file* is read (`nls.io`). On a vector space
all four are z - h.

Sources: R. Kuemmerle et al., "g2o", ICRA 2011; G. Grisetti et al., "A tutorial on graph-based SLAM", 2010; F. Dellaert,
M. Kaess, "Factor graphs for robot perception", 2017.
"""

from __future__ import annotations

from models import LieGroup, Manifold
from models.algebra import Array
from models.errors import OptionError

__all__ = ["CONVENTIONS", "check_convention"]

CONVENTIONS = ("log", "g2o", "graphslam", "gtsam")


def check_convention(name: str) -> str:
    """The name itself when there is such a convention.

    Raises
    ------
    OptionError
    """
    if not isinstance(name, str) or name not in CONVENTIONS:
        raise OptionError("convention", name, "one of " + ", ".join(CONVENTIONS))
    return name


def innovation(
    space: Manifold, h: Array, z: Array, convention: str = "log", jacobian: bool = True
) -> tuple[Array, Array | None]:
    """e = z [-] h and its J as above; J is None where it is the identity, or not asked for.

    Parameters
    ----------
    space : the space z and h live in.
    h, z : (n, size) stacks.
    convention : one of `CONVENTIONS`.
    jacobian : whether J is wanted.

    Returns
    -------
    e : (n, dim) array.
    J : (n, dim, dim) array or None.
    """
    if not isinstance(space, LieGroup):
        return space.innovation(h, z)
    if space.flat:
        return space.local(h, z), None
    if convention == "g2o":
        E = space.between(z, h)
        return -space.vector(E), space.vector_jr(E) if jacobian else None
    E = space.between(h, z)
    if convention == "graphslam":
        return space.vector(E), space.vector_jl(E) if jacobian else None
    e = space.log(E)
    return e, space.jl_inv(e) if jacobian else None
