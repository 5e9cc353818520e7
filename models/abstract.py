"""The root of abstract base classes: methods a subclass must give, and `isinstance` as for any other class."""

from __future__ import annotations

from abc import ABCMeta

__all__ = ["Abstract"]


class _Meta(ABCMeta):
    """`abc.ABC` lets classes register as virtual subclasses, which nobody does here, and so asks every subclass of a
    class in turn when a type is looked at for the first time: 1 ms of the 25 ms of the first small solve of a process.
    """

    __instancecheck__ = type.__instancecheck__
    __subclasscheck__ = type.__subclasscheck__


class Abstract(metaclass=_Meta):
    """A class whose abstract methods have to be given before it can be instantiated.

    Examples
    --------
    >>> from abc import abstractmethod
    >>> class Shape(Abstract):
    ...     @abstractmethod
    ...     def area(self) -> float: ...
    >>> class Square(Shape):
    ...     def area(self) -> float:
    ...         return 1.0
    >>> isinstance(Square(), Shape), isinstance(1.0, Shape)
    (True, False)
    """
