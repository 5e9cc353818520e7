r"""The factor contract: a batch of n measurements of one kind, and the one place of every sign and every whitener.

A subclass gives the prediction h(X) and its Jacobians H_k; this module turns them into

    e = z [-] h(X0),   A_k = W J H_k,   b = W e,   W'W = Sigma^-1,   e(h Exp(xi)) = e - J xi + ...

so that the step is argmin |A dx - b| for every factor, convention and noise. See the page on least squares.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from itertools import combinations
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from factors.conventions import check_convention, innovation
from factors.declared import attributes, copied, declared
from factors.differences import central_differences
from factors.keys import Keys
from factors.missing import name_the_noise
from factors.noise import Noise, arranged, weights, whiten
from factors.noise_size import refuse_other_size
from factors.return_values import checked_jacobians, checked_prediction, checked_space, refuse_extreme, squarable
from factors.robust import Kernel, Robust
from factors.slices import part, places, rows
from factors.traits import Traits
from models import Manifold
from models.abstract import Abstract
from models.algebra import Array, Index, product
from models.errors import EvaluationError, GraphError, NoiseModelError
from models.finite import first_not_finite

__all__ = ["Factor", "Model"]

Jacobians = tuple[Array | None, ...] | None


class Factor(Traits, Abstract):
    """A batch of n measurements of one kind: its variables, the measured values, their noise.

    A subclass states `slots` (the space of each variable it touches; None accepts any) and `relative`, and implements
    `space` and `predict`. Everything else follows.

    Parameters
    ----------
    keys : one `Keys` per slot; a slot of one variable serves all n measurements.
    z : (n, size) stack of measurements, or one.
    noise : error of z in the tangent space at the prediction, one model for all or one matrix per measurement.
    convention : how z [-] h is formed on a group, `factors.conventions`.

    Raises
    ------
    GraphError
        Keys, measurements and noise that do not fit together, as far as that is known without values.

    Attributes
    ----------
    relative : True when the residual does not change if all variables are moved by the same group element; beside poses
        this includes turns, unless `knows_axes`. The gauge of a part may be held where all its factors say so.
    unmoved : slots that a common motion of everything does not touch, such as the calibration of a sensor. They neither
        anchor a part of the graph nor join two parts.
    per_measurement : names of the attributes that may hold one row per measurement, besides keys, z and noise. A part
        of the batch takes its rows of them. Those of its base classes count as well.
    shared : names of the attributes that all measurements use whole. An array or list of as many rows as there are
        measurements that neither names is refused where a part is taken or batches are joined.
    limit_only : True when it says that something is within limits: no measurement, its rows are no degrees of freedom.
    eliminated : unknowns of its own that each measurement has already spent: as many fewer degrees of freedom.
    damped : True when undamped steps are known to fail: where the library chooses, it takes Levenberg-Marquardt.
    framed : True when its `innovation` takes poses with their frames, `Manifold.framed`.
    frame, opaque : traits, see `factors.traits`; a new sensor states its uses by these and by the methods there.
    """

    slots: tuple[Manifold | None, ...] = ()
    relative: bool = False
    damped: bool = False
    framed: bool = False
    unmoved: tuple[int, ...] = ()
    per_measurement: ClassVar[tuple[str, ...]] = ()
    shared: ClassVar[tuple[str, ...]] = ()
    limit_only: ClassVar[bool] = False
    eliminated: ClassVar[int] = 0
    __copy__ = copied

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        name_the_noise(cls)
        cls.per_measurement, cls.shared = declared(cls, "per_measurement"), declared(cls, "shared")

    def __init__(self, keys: Sequence[Keys], z: npt.ArrayLike, noise: Noise, convention: str = "log") -> None:
        name = self.name
        for k in keys:
            if not isinstance(k, Keys):
                raise GraphError(f"{name}: expected variables such as x[0] or x[i], got {k!r:.80}", factor=name)
        if not isinstance(noise, Noise):
            raise GraphError(f"{name}: expected a noise model such as Isotropic(0.1), got {noise!r:.80}", keys, name)
        n = 0 if any(len(k) == 0 for k in keys) else max((len(k) for k in keys), default=0)
        if any(len(k) not in (1, n) for k in keys):
            raise GraphError(f"{name}: its variables number {[len(k) for k in keys]}; expected 1 or {n}", keys, name)
        self.keys = tuple(k if len(k) == n else k[np.zeros(n, dtype=np.intp)] for k in keys)
        for a, b in combinations(self.keys, 2):
            if a.kind == b.kind and (same := a.numbers == b.numbers).any():
                twice = a[[int(np.argmax(same))]]
                raise GraphError(f"{name}: measurement {np.argmax(same)} connects {twice} to itself", [twice], name)
        try:
            self._z = np.array(z, dtype=float)  # a copy, and read-only: what was added stays what it was
        except (TypeError, ValueError, OverflowError) as error:
            raise GraphError(f"{name}: z is not an array of numbers: {error}", keys, name) from error
        self._z.setflags(write=False)
        self._noise = noise
        refuse_other_size(self, noise)
        self.convention = check_convention(convention)
        self._model: Model | None = None

    def __len__(self) -> int:
        return len(self.keys[0]) if self.keys else 0

    def __getitem__(self, index: int | slice | npt.ArrayLike) -> Self:
        """A factor of this kind with some of the measurements, by number, slice, array of numbers or mask (n,).

        What all measurements share stays shared; a robust kernel stays.

        Raises
        ------
        GraphError
            No such measurements; z, not yet used, of shape (n,) that may be n measurements or one of n numbers; an
            array of n rows that its class does not declare, `per_measurement` and `shared`.

        Examples
        --------
        >>> from factors import Isotropic, Range
        >>> from nls import kinds
        >>> x, l = kinds("x", "l")
        >>> ranges = Range(x[[3, 4, 5]], l[0], [10.0, 11.0, 99.0], Isotropic([0.1, 0.2, 0.3]))
        >>> near = ranges[ranges.z < 50]
        >>> near, near.z, near.noise.sigma
        (Range(x[3, 4], l[0, 0]), array([10., 11.]), array([0.1, 0.2]))
        """
        subset: Self = part(self, places(index, len(self), self.name))
        return subset

    def __getstate__(self) -> tuple[dict[str, Any], list[str]]:
        """The attributes without the model, which is bound anew, and the names of the read-only arrays."""
        state = {**attributes(self), "_model": None}
        return state, [name for name, a in state.items() if isinstance(a, np.ndarray) and not a.flags.writeable]

    def __setstate__(self, state: tuple[dict[str, Any], list[str]]) -> None:
        for name, value in state[0].items():
            setattr(self, name, value)
        for name in state[1]:
            getattr(self, name).setflags(write=False)

    def __iter__(self) -> Iterator[Factor]:
        """The measurements one by one; without this Python would count up until an IndexError."""
        return (self[k] for k in range(len(self)))

    def sizes(self) -> tuple[int, ...]:
        """How many numbers a measurement may have, known before its `__init__` and the spaces are; () for any."""
        return ()

    @property
    def z(self) -> Array:
        """The measured values, as given; read-only."""
        return self._z

    @property
    def noise(self) -> Noise:
        """The noise model, as given; read-only."""
        return self._noise

    @property
    def name(self) -> str:
        """Kind of this measurement, for messages."""
        return type(self).__name__

    def __repr__(self) -> str:
        return f"{self.name}({', '.join(map(repr, self.keys))})"

    def describe(self, index: int) -> str:
        """One measurement of the batch by type and variables, for messages: ``Between(x3, x4)``."""
        return f"{self.name}({', '.join(repr(k[[index]]) for k in self.keys)})"

    def _refusal(self, problem: str) -> GraphError:
        """The error of a factor that does not fit, to be raised: it names the factor and its variables."""
        return GraphError(f"{self!r}: {problem}", self.keys, self.name)

    def chi2(self, values: Any) -> Array:
        """Squared whitened length |b_i|^2 (n,) of every measurement at some values, before any robust kernel."""
        model, X = values.gather(self)
        return np.asarray(np.square(model.error(*X)).sum(axis=1))

    def weights(self, values: Any) -> Array:
        """Weight (n,) the robust kernel gives every measurement at some values: 1 an inlier, near 0 an outlier."""
        kernel, s = self.kernel, self.chi2(values)
        return np.ones(len(s)) if kernel is None else kernel.weight(s)

    @property
    def kernel(self) -> Kernel | None:
        """The robust kernel of its noise."""
        return self.noise.kernel if isinstance(self.noise, Robust) else None

    def robust(self, kernel: Kernel) -> Factor:
        """The measurements under a robust kernel, instead of the one they may have."""
        robust_factor = copy(self)
        robust_factor._noise = Robust(self.noise.noise if isinstance(self.noise, Robust) else self.noise, kernel)
        return robust_factor

    @abstractmethod
    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        """The space the measurement lives in, given those of the variables."""

    @abstractmethod
    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        """Prediction h (n, size) and Jacobians H_k (n, dim, dim_k), one per slot, of h(X [+] d) = h [+] H d.

        An H_k of None is the identity; None for the whole tuple asks for central differences.
        """

    def innovation(self, model: Model, X: tuple[Array, ...], jacobians: bool = True) -> tuple[Array, tuple[Array, ...]]:
        """e = z [-] h(X) (n, dim), and J_k (n or 1, dim, dim_k) of e(X [+] d) = e - J d, one per slot, where asked for.

        Here by `predict` and the convention; a subclass may have all in one pass, of poses with frames (`framed`).
        """
        h, H = checked_prediction(self, self.predict(model.manifolds, *X), model.z.shape)
        e, J = innovation(model.space, h, model.z, self.convention, jacobians)
        if not jacobians:
            return e, ()
        if H is None:
            H = central_differences(self, model.manifolds, model.space, X, h)
        H = checked_jacobians(self, H, len(h), model.space.dim, model.manifolds)
        if J is None:
            return e, tuple([np.eye(model.space.dim)[None] if H_k is None else H_k for H_k in H])
        return e, tuple([J if H_k is None else product(J, H_k) for H_k in H])

    def rows(self, space: Manifold) -> Index | slice:
        """Which components of the innovation are measured; all, unless a subclass says otherwise."""
        return slice(None)

    def names(self, space: Manifold) -> tuple[str, ...]:
        """Names of the measured components, for named noise and the labels of rows."""
        return tuple(np.array(space.components)[self.rows(space)].tolist())

    @np.errstate(over="ignore", invalid="ignore")
    def bind(self, *manifolds: Manifold) -> Model:
        """The factor with the spaces of its variables: z checked, the whitener computed once.

        Raises
        ------
        GraphError, NoiseModelError
            A slot that does not accept its space; a measurement or noise of the wrong shape.
        """
        model = self._model  # read once, and what is returned is never read back: threads may bind one factor at once
        if model is None or model.manifolds != manifolds:
            name = self.name
            if isinstance(self.slots, Manifold):
                raise self._refusal(f"slots is one space, expected a tuple: slots = ({self.slots!r},)")
            if len(self.slots) != len(self.keys):
                raise self._refusal(
                    f"its `slots` state {len(self.slots)} spaces, it has {len(self.keys)} variables; set one for each, "
                    "such as slots = (SE2, R(2)), None for any"
                )
            for required, manifold, keys in zip(self.slots, manifolds, self.keys, strict=True):
                if required is not None and required is not manifold:
                    raise GraphError(
                        f"{name}: {keys[[0]]} is in {manifold}, this factor needs {required}", [keys], name
                    )
            space = checked_space(self, self.space(manifolds))
            try:
                z = space.stack(self.z)
                if len(z) not in (1, len(self)):
                    raise GraphError(f"{len(z)} measurements for {len(self)} sets of variables")
                rows, names = self.rows(space), self.names(space)
                W = weights(self.noise, len(self), names)
            except NoiseModelError as error:
                message = f"{self.describe(error.index)}: {error}"
                raise NoiseModelError(message, error.matrix, error.index, error.value, self.keys) from error
            except GraphError as error:
                raise GraphError(f"{self!r}: {error}", self.keys, name) from error
            z = self.with_frames(space, np.asfortranarray(np.broadcast_to(z, (len(self), space.size))))
            model = self._model = Model(self, manifolds, space, z, arranged(W), rows, names)
        return model

    def with_frames(self, space: Manifold, z: Array) -> Array:
        """Measurements (n, size), with their frames where it takes them."""
        return space.framed(z) if self.framed else z

    @staticmethod
    def from_function(
        residual: Callable[..., Array],
        keys: Keys | Sequence[Keys],
        dim: int,
        noise: Noise | None = None,
        jacobians: Callable[..., Sequence[Array]] | None = None,
        relative: bool = False,
    ) -> Factor:
        """A factor from a function of yours: minimizes |residual|^2 under the noise.

        Parameters
        ----------
        residual : called as ``residual(X_1, ...)`` with stacks (n, size_k), one row per measurement; returns (n, dim).
        keys : the variables, one `Keys` per argument.
        dim : numbers per residual.
        noise : noise of the residual; unit variance when omitted.
        jacobians : called with the same stacks; returns one (n, dim, dim_k) array per slot, the derivative of the
            residual with respect to a tangent step of that variable. Central differences when omitted.
        relative : True when a shift of everything, beside poses also a turn, changes nothing: the gauge may be fixed.

        Raises
        ------
        EvaluationError
            At evaluation: wrong shape, a number that is not finite, an exception in your code (chained).

        Examples
        --------
        >>> import numpy as np
        >>> from factors import Factor, Isotropic
        >>> from models import R
        >>> from nls import FactorGraph, Values, kinds
        >>> (p,) = kinds("p")
        >>> graph = FactorGraph()
        >>> rosenbrock = lambda X: np.stack([10 * (X[:, 1] - X[:, 0] ** 2), 1 - X[:, 0]], axis=1)
        >>> _ = graph.add(Factor.from_function(rosenbrock, p[0], dim=2))
        >>> graph.optimize(Values({p: (R(2), [-1.2, 1.0])})).values[p[0]].round(6)
        array([1., 1.])
        """
        from factors.function import FunctionFactor

        return FunctionFactor(residual, [keys] if isinstance(keys, Keys) else keys, dim, noise, jacobians, relative)


class Model(NamedTuple):
    """A factor bound to the spaces of its variables, as assembly and filters call it. Arrays in, arrays out."""

    factor: Factor
    manifolds: tuple[Manifold, ...]
    space: Manifold
    framed_z: Array  # with frames where the factor takes them
    W: Array
    rows: Index | slice
    names: tuple[str, ...]

    @property
    def z(self) -> Array:
        """The measurements (n, size), in the stored form of their space."""
        return self.framed_z[:, : self.space.size]

    @property
    def dim(self) -> int:
        """Numbers per measurement."""
        return len(self.names)

    def part(self, factor: Factor, index: Index) -> Model:
        """The model of a factor that has some of the measurements, by place (k,)."""
        W = arranged(rows(self.W, index, len(self.framed_z)))
        return self._replace(factor=factor, framed_z=np.asfortranarray(self.framed_z[index]), W=W)

    def refuse_extreme(self) -> None:
        """Refuse a measurement or weight whose square is no number, see `factors.return_values.refuse_extreme`."""
        refuse_extreme(self.factor, self.z, self.W, self.names)

    @np.errstate(over="ignore", invalid="ignore")  # what is not finite is refused below, by name
    def error(self, *X: Array) -> Array:
        """Whitened innovation b (n, m) alone, for the cost of a trial point."""
        return self.whitened(self.factor.innovation(self, X, jacobians=False)[0])

    @np.errstate(over="ignore", invalid="ignore")
    def linearize(self, *X: Array) -> tuple[tuple[Array, ...], Array]:
        """Whitened Jacobians A_k (n, m, dim_k), one per slot, and innovations b (n, m), at the stacks X."""
        e, (*A,) = self.factor.innovation(self, X)  # a list: each Jacobian goes as its whitened one comes
        b, n = self.whitened(e), len(e)
        for slot in range(len(A)):
            A[slot] = A_k = whiten(self.W, A[slot][:, self.rows])
            self._check(A_k, slot)
            A[slot] = A_k if len(A_k) == n else np.broadcast_to(A_k, (n, *A_k.shape[1:]))
        return tuple(A), b

    def whitened(self, e: Array) -> Array:
        """b = W e (n, m) of innovations e (n, dim)."""
        self._check(e, None)
        return squarable(self.factor, whiten(self.W, e[:, self.rows]))

    def _check(self, array: Array, slot: int | None) -> None:
        """Refuse numbers that are not finite, naming the measurement."""
        if np.isfinite(np.add.reduce(array, axis=None)) or (index := first_not_finite(array)) is None:
            return
        quantity = "residual" if slot is None else f"Jacobian with respect to {self.factor.keys[slot][[index]]}"
        raise EvaluationError(
            f"{self.factor.describe(index)}: its {quantity} is not finite: {array[index].tolist()}; "
            "check the values of its variables and the function",
            self.factor.name,
            [k[[index]] for k in self.factor.keys],
            where=quantity,
        )
