"""Every exception and warning of the library, and the sentence each one says.

An error names the thing (keys, factor, file and line), what was expected, what came, and what to do next. The second
base class of each keeps code such as ``except ValueError`` working. Everything imports from here; `nls` re-exports.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from models.advice import Advice, listed
from models.visible import visible

__all__ = [
    "EvaluationError",
    "GraphError",
    "GraphFileError",
    "GraphWarning",
    "JacobianError",
    "LeadlineError",
    "MissingSolverError",
    "NoiseModelError",
    "OptionError",
    "ResourceLimitError",
    "SingularGeometryError",
    "UnderconstrainedError",
]


class LeadlineError(Exception):
    """Base class of every error this library raises. Its copy from another process is the same, built as it was.

    Parameters
    ----------
    message : the fault, with the name of the thing and its number.
    advice : what helps; ``str()`` has it as Python writes it, one a line.
    """

    def __init__(self, message: str = "", advice: Sequence[Advice] = ()) -> None:
        self.message, self.advice = message, tuple(advice)
        super().__init__("\n".join(self.lines()))

    def lines(self, shell: bool = False) -> list[str]:
        """The message and its cures, as Python or as the command line writes them."""
        return [visible(self.message), *(f"  -> {visible(words)}" for words in listed(self.advice, shell))]

    @property
    def is_fault(self) -> bool:
        """Whether code of the user's raised an exception: a fault to see, no place where a measurement has no value."""
        return False

    def advise(self, *advice: Advice) -> None:
        """Add cures."""
        self.advice += advice
        self.args = ("\n".join(self.lines()),)

    def leave_out(self, in_use: Collection[str]) -> None:
        """Drop the cures that are in use already, as Python or the command line writes them."""
        self.advice = tuple(piece for piece in self.advice if not piece.repeats(in_use))
        self.args = ("\n".join(self.lines()),)

    def __reduce__(self) -> tuple[Any, ...]:
        return _as_it_was, (type(self), self.args), vars(self)


def _as_it_was(kind: type[LeadlineError], args: tuple[Any, ...]) -> LeadlineError:
    error = BaseException.__new__(kind, *args)  # kind.__new__ may be MemoryError's, which refuses a subclass
    super(LeadlineError, error).__init__(*args)  # its standard base, which keeps them, too
    return error


class GraphFileError(LeadlineError, ValueError):
    """Something wrong in a file; ``str()`` begins with path and line, ``survey.g2o:17:``.

    Parameters
    ----------
    message : what is wrong and what to do.
    path : the file.
    line : its line, counted from 1; None when the whole file is meant.
    text : the offending line, cut to 80 characters.
    advice : what helps.
    """

    def __init__(
        self,
        message: str,
        path: str = "<text>",
        line: int | None = None,
        text: str = "",
        advice: Sequence[Advice] = (),
    ) -> None:
        self.path, self.line, self.text = path, line, text[:80]
        where = path if line is None else f"{path}:{line}"
        super().__init__(f"{where}: {message}" + (f" [{self.text}]" if text else ""), advice)


class GraphError(LeadlineError, ValueError):
    """A graph, factor or set of values that cannot be built: keys, dimensions, types; `index`: of which measurement."""

    def __init__(
        self,
        message: str,
        keys: Sequence[Any] = (),
        factor: str = "",
        index: int = 0,
        advice: Sequence[Advice] = (),
    ) -> None:
        self.keys, self.factor, self.index = tuple(keys), factor, index
        super().__init__(message, advice)


class NoiseModelError(GraphError):
    """A covariance, information or sigma that is none.

    Parameters
    ----------
    message : what is wrong and what to do.
    matrix : the kind of matrix ("information", "covariance", ...).
    index : the measurement of the batch it belongs to.
    value : the offending eigenvalue or entry.
    keys : the variables of the factor, once it is bound.
    """

    def __init__(
        self,
        message: str,
        matrix: str = "",
        index: int = 0,
        value: float = float("nan"),
        keys: Sequence[Any] = (),
    ) -> None:
        self.matrix, self.value = matrix, value
        super().__init__(message, keys, index=index)


class EvaluationError(LeadlineError, ArithmeticError):
    """A residual or Jacobian that is not finite or has the wrong shape, or code of the user's that raised."""

    def __init__(
        self, message: str, factor: str = "", keys: Sequence[Any] = (), iteration: int | None = None, where: str = ""
    ) -> None:
        self.factor, self.keys, self.iteration, self.where = factor, tuple(keys), iteration, where
        super().__init__(message)

    @property
    def is_fault(self) -> bool:
        return self.__cause__ is not None


class JacobianError(EvaluationError):
    """An analytic derivative that disagrees with central differences.

    Parameters
    ----------
    message : the factor, the entry and both values.
    factor : the kind of factor.
    entry : the worst one, (slot, measurement, row, column).
    analytic, numeric : both values of it.
    deviation : how much they differ, relative to the largest entry of the column.
    """

    def __init__(
        self,
        message: str,
        factor: str = "",
        entry: tuple[int, ...] = (),
        analytic: float = float("nan"),
        numeric: float = float("nan"),
        deviation: float = float("nan"),
    ) -> None:
        self.entry, self.analytic, self.numeric, self.deviation = entry, analytic, numeric, deviation
        super().__init__(message, factor)


class UnderconstrainedError(LeadlineError, np.linalg.LinAlgError):
    """The measurements do not determine every unknown.

    Parameters
    ----------
    message : the free variables and directions.
    keys : the variables that can move without any measurement noticing.
    nullity : how many independent directions are free.
    components : one text per free direction, e.g. ``"x3: yaw"``.
    values : the best values reached before the singular system was met.
    advice : the usual cures.
    silent : factor and number of a measurement of them that has no information, counted from 0; None where none is.
    """

    def __init__(
        self,
        message: str,
        keys: Sequence[Any] = (),
        nullity: int = 0,
        components: Sequence[str] = (),
        values: Any = None,
        advice: Sequence[Advice] = (),
        silent: tuple[int, int] | None = None,
    ) -> None:
        self.keys, self.nullity, self.components, self.values = tuple(keys), nullity, tuple(components), values
        self.silent = silent
        super().__init__(message, advice)


class ResourceLimitError(LeadlineError, MemoryError):
    """More memory would be needed than is allowed; refused before it was taken."""

    def __init__(self, message: str, needed: float = 0.0, limit: float = 0.0, subject: str = "") -> None:
        self.needed, self.limit, self.subject = needed, limit, subject
        super().__init__(message)


class SingularGeometryError(LeadlineError, ArithmeticError):
    """A measurement model evaluated where it has no value: zero range, gimbal lock, a point behind the camera."""

    def __init__(self, message: str, factor: str = "", keys: Sequence[Any] = ()) -> None:
        self.factor, self.keys = factor, tuple(keys)
        super().__init__(message)


class MissingSolverError(LeadlineError, ImportError):
    """A linear solver was asked for by name and its package is not installed."""


class OptionError(LeadlineError, ValueError):
    """An option with a value it cannot have.

    Parameters
    ----------
    option : its name; or, alone, the whole message.
    value : the value that was given.
    allowed : the values it can have; empty where the option itself is the mistake.
    """

    def __init__(self, option: str, value: Any = None, allowed: str = "") -> None:
        self.option, self.value, self.allowed = option, value, allowed
        super().__init__(self._sentence(option))

    def _sentence(self, name: str) -> str:
        return f"{name}: {self.value!r} is not possible; expected {self.allowed}" if self.allowed else name

    def lines(self, shell: bool = False) -> list[str]:
        """The message; on the command line with the name of its option there."""
        as_option = shell and self.option.isidentifier() and not self.option.isupper()  # OUT is no option but a place
        return [visible(self._sentence(f"--{self.option.replace('_', '-')}" if as_option else self.option))]


class GraphWarning(UserWarning):
    """Something in a graph or file deserves a look: ignored lines, isolated variables."""

    def __init__(self, message: str = "") -> None:
        super().__init__(visible(message))
