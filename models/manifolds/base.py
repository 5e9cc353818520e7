"""The interface of a space of unknowns or measurements, and its extension by every Lie group.

The library perturbs on the right, in the body frame, translation first: X <- X Exp(delta), delta = (rho, phi).
Functions take and return whole stacks: the leading axes are the batch, the last one is the stored form.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from models.abstract import Abstract
from models.algebra import Array, apply, product
from models.errors import GraphError, OptionError
from models.finite import first_not_finite
from models.manifolds.rigid import homogeneous
from models.manifolds.units import unit

__all__ = ["LieGroup", "Manifold"]


class Manifold(Abstract):
    """A space in which estimates move: stored form, tangent space, and the two maps between them.

    Attributes
    ----------
    name : how the space prints, "SE2".
    dim : dimension of the tangent space (degrees of freedom).
    size : numbers per stored element.
    components : names of the tangent components, in order.
    units : of them, such as ``("m", "rad")``; m for x, y, z and range, rad for angles by their names when not stated.
    body_axes : whether the tangent space has the axes of the body, so that a covariance has to say its frame.

    Notes
    -----
    A space is one object, and compared as such: its copy is itself, also in another process. So a space of your own is
    pickled by its name, under which its module must hold it: ``SPHERE = Sphere()`` with the name "SPHERE". One with
    parameters returns in `__reduce__` the function that makes it and the arguments, as R(n) does.
    """

    name: str
    dim: int
    size: int
    components: tuple[str, ...]
    body_axes: ClassVar[bool] = False

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each component, as reports print it; by the names, unless a space of your own states ``units``."""
        return tuple(map(unit, self.components))

    @abstractmethod
    def retract(self, X: Array, delta: Array) -> Array:
        """The element reached from X (..., size) by the tangent step delta (..., dim)."""

    @abstractmethod
    def local(self, X: Array, Y: Array) -> Array:
        """The tangent step (..., dim) from X to Y: ``retract(X, local(X, Y)) == Y``."""

    def motion(self, X0: Array, X: Array) -> tuple[Array, Array]:
        """`local` from X0 to X, c (..., dim), and its derivative J (..., dim, dim), c(X [+] d) = c + J d.

        The poses of space have other coordinates, which keep apart what gravity tells of a pose.
        """
        c = self.local(X0, X)
        return c, np.broadcast_to(np.eye(self.dim), (*c.shape, self.dim))

    def innovation(self, h: Array, z: Array) -> tuple[Array, Array | None]:
        """e = z [-] h (..., dim), and J with e(h [+] d) = e - J d + ...; None for the identity.

        Groups have the conventions of `factors.conventions` instead.
        """
        return self.local(h, z), None

    @abstractmethod
    def identity(self, n: int = 1) -> Array:
        """A stack (n, size) of the neutral element."""

    def coordinates(self, X: Array) -> Array:
        """How far X (n, size) is from the neutral element, (n, dim): the tangent step, or numbers of its size."""
        return self.local(self.identity(len(X)), X)

    def framed(self, X: Array) -> Array:
        """X (n, size), and behind it what its rotations are made of; X itself of a space that has none, or has it."""
        return X

    @abstractmethod
    def position(self, X: Array) -> Array:
        """Where to draw X: a stack (..., 2 or 3) in meters, (..., 0) for a space without places."""

    def world_axes(self, X: Array) -> Array:
        """G (..., dim, dim): G delta is the step delta at X (..., size) by components along the axes of the world.

        Position first, as in the tangent space: the first rows are the change of `position`, m, the others that of the
        rotation, rad. The identity where the tangent space has the axes of the world already.
        """
        return np.broadcast_to(np.eye(self.dim), (*np.shape(X)[:-1], self.dim, self.dim))

    def euler_axes(self, X: Array) -> Array:
        """J (..., 6, dim): change of (roll, pitch, yaw, x, y, z) with the step delta at X (..., size), rad and m.

        Raises
        ------
        OptionError
            The elements of the space are no poses in space.
        SingularGeometryError
            Gimbal lock.
        """
        raise OptionError("view", "euler", f"'position' or none: {self.name} has no roll, pitch, yaw, x, y, z")

    def invalid(self, X: Array) -> tuple[int, str] | None:
        """First element of the stack (n, size) that is no element of the space, and why; None when all are."""
        k = first_not_finite(X)
        return None if k is None else (k, "a number is not finite")

    def stack(self, X: npt.ArrayLike) -> Array:
        """A checked stack (n, size), from one element (size,), or n of them.

        Raises
        ------
        GraphError
            Wrong shape, a number that is not finite, or no element of the space (a quaternion of length 0).
        """
        try:
            Y = np.array(X, dtype=float)
        except (TypeError, ValueError, OverflowError) as error:
            raise GraphError(f"{self.name}: expected numbers of shape (n, {self.size}); {error}") from error
        if Y.ndim == 0 and self.size == 1:
            Y = Y[None]
        if Y.ndim == 1 and self.size == 1:
            Y = Y[:, None]
        Y = np.atleast_2d(Y)
        if Y.ndim != 2 or Y.shape[1] != self.size:
            raise GraphError(
                f"{self.name}: elements have shape {np.shape(X)}, expected (n, {self.size}): one element per row"
            )
        problem = self.invalid(Y)
        if problem is not None:
            raise GraphError(f"{self.name}: element {problem[0]} is {Y[problem[0]].tolist()}: {problem[1]}")
        return Y

    def __repr__(self) -> str:
        return self.name

    def __reduce__(self) -> str | tuple[Any, ...]:
        return self.name


class LieGroup(Manifold):
    """A manifold with a product. Subclasses give the closed forms; this class derives the rest.

    Attributes
    ----------
    point_dim : dimension of the points the group acts on; 0 where it acts on none.
    flat : whether the group commutes, so that every Jacobian is the identity (vectors, the circle).
    """

    point_dim: int = 0
    flat: ClassVar[bool] = False

    @abstractmethod
    def exp(self, delta: npt.ArrayLike, /) -> Array:
        """Group element Exp(delta), (..., dim) to (..., size)."""

    @abstractmethod
    def log(self, X: npt.ArrayLike, /) -> Array:
        """Tangent vector Log(X), (..., size) to (..., dim); Exp(Log(X)) = X."""

    @abstractmethod
    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        """X o Y."""

    @abstractmethod
    def inverse(self, X: npt.ArrayLike) -> Array:
        """X^-1."""

    @abstractmethod
    def adjoint(self, X: npt.ArrayLike, /) -> Array:
        """Ad_X (..., dim, dim): X Exp(delta) = Exp(Ad_X delta) X."""

    def adjoint_inverse(self, X: npt.ArrayLike) -> Array:
        """Ad of X^-1."""
        return self.adjoint(self.inverse(X))

    @abstractmethod
    def jl(self, delta: npt.ArrayLike, /) -> Array:
        """Left Jacobian of Exp (..., dim, dim): Exp(delta + d) = Exp(jl(delta) d) Exp(delta) + O(d^2)."""

    @abstractmethod
    def jl_inv(self, delta: npt.ArrayLike, /) -> Array:
        """Inverse of the left Jacobian: Log(Exp(d) Exp(delta)) = delta + jl_inv(delta) d + O(d^2)."""

    @abstractmethod
    def vector(self, X: npt.ArrayLike, /) -> Array:
        """The chart of pose-graph files (..., dim): translation, and wrapped angle or quaternion vector part.

        In three dimensions the rotation part is *half* a rotation vector to first order, of the quaternion with w >= 0.
        """

    @abstractmethod
    def vector_jl(self, X: npt.ArrayLike, /) -> Array:
        """d vector(Exp(d) X) / dd at 0, (..., dim, dim)."""

    @abstractmethod
    def vector_jr(self, X: npt.ArrayLike, /) -> Array:
        """d vector(X Exp(d)) / dd at 0, (..., dim, dim)."""

    def jr(self, delta: npt.ArrayLike) -> Array:
        """Right Jacobian of Exp: Exp(delta + d) = Exp(delta) Exp(jr(delta) d) + O(d^2); jr(delta) = jl(-delta)."""
        return self.jl(-np.asarray(delta, dtype=float))

    def jr_inv(self, delta: npt.ArrayLike) -> Array:
        """Inverse of the right Jacobian: Log(X Exp(d)) = Log X + jr_inv(Log X) d + O(d^2)."""
        return self.jl_inv(-np.asarray(delta, dtype=float))

    def between(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        """X^-1 o Y: Y as seen from X."""
        return self.compose(self.inverse(X), Y)

    def misfit(self, X: Array, Y: Array, Z: Array, jacobians: bool = True) -> tuple[Array, Array | None]:
        """c = vector(Z^-1 X^-1 Y) (n, dim), how far Y is off from where a step Z leads from X; all three `framed`.

        With its derivatives by steps of X and of Y, side by side (n, dim, 2 dim), where they are asked for.
        """
        h = self.between(X, Y)
        E = self.between(Z, h)
        J = self.vector_jr(E) if jacobians else None
        return self.vector(E), None if J is None else np.concatenate([-product(J, self.adjoint_inverse(h)), J], axis=2)

    def rotation(self, X: npt.ArrayLike) -> Array:
        """Rotation matrix of X, (..., k, k) with k = point_dim, body to world."""
        raise GraphError(f"{self.name} has no rotation matrix")

    def matrix(self, X: npt.ArrayLike) -> Array:
        """Matrix of X: [[R, t], [0, 1]] (..., k+1, k+1) of a pose, R (..., k, k) of a rotation, k = point_dim.

        Examples
        --------
        >>> from models import SE2
        >>> SE2.matrix([5.0, 6.0, np.pi / 2]).round(6)
        array([[ 0., -1.,  5.],
               [ 1.,  0.,  6.],
               [ 0.,  0.,  1.]])
        """
        X = np.asarray(X, dtype=float)
        R, t = self.rotation(X), self.position(X)
        return homogeneous(R, t) if t.shape[-1] else R

    def act(self, X: npt.ArrayLike, p: npt.ArrayLike) -> Array:
        """Points p (..., point_dim) of the body frame in world coordinates, R p + t, meters."""
        X = np.asarray(X, dtype=float)
        rotated = apply(self.rotation(X), np.asarray(p, dtype=float))
        t = self.position(X)
        return rotated + t if t.shape[-1] else rotated

    def retract(self, X: Array, delta: Array) -> Array:
        """X Exp(delta)."""
        return self.compose(X, self.exp(delta))

    def local(self, X: Array, Y: Array) -> Array:
        """Log(X^-1 Y)."""
        return self.log(self.between(X, Y))

    def motion(self, X0: Array, X: Array) -> tuple[Array, Array]:
        c = self.local(X0, X)
        return c, self.jr_inv(c)

    def coordinates(self, X: Array) -> Array:
        return self.log(X)

    def interpolate(self, X: npt.ArrayLike, Y: npt.ArrayLike, t: npt.ArrayLike) -> Array:
        """X Exp(t Log(X^-1 Y)): from X at t = 0 to Y at t = 1 with a constant velocity, along the shorter turn.

        Parameters
        ----------
        X, Y : (size,) or (n, size) elements.
        t : one number, or (n,); below 0 and above 1 it extrapolates.

        Returns
        -------
        (size,) or (n, size) array.

        Examples
        --------
        >>> from models import SE2
        >>> SE2.interpolate([0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.25, 1.0])
        array([[0. , 0. , 0. ],
               [0.5, 0. , 0. ],
               [2. , 0. , 0. ]])
        """
        X, Y = np.asarray(X, dtype=float), np.asarray(Y, dtype=float)
        return self.retract(X, np.asarray(t, dtype=float)[..., None] * self.local(X, Y))


def block_triangular(A: Array, B: Array, C: Array) -> Array:
    """[[A, B], [0, C]] for stacks of square blocks; (..., a, a), (..., a, c), (..., c, c)."""
    a, c = A.shape[-1], C.shape[-1]
    batch = np.broadcast(A[..., 0, 0], B[..., 0, 0], C[..., 0, 0]).shape
    out = np.zeros((*batch, a + c, a + c))
    out[..., :a, :a] = A
    out[..., :a, a:] = B
    out[..., a:, a:] = C
    return out
