"""Where the time goes inside one call: the library marks its stages, and a caller who wants to know collects them.

Long stages also say how far they are, to a caller who listens.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from time import perf_counter
from typing import TypeVar

T = TypeVar("T")
_SECONDS: ContextVar[dict[str, float] | None] = ContextVar("seconds", default=None)
_INSIDE: ContextVar[bool | None] = ContextVar("inside", default=None)
_LISTENER: ContextVar[Callable[[str], object] | None] = ContextVar("listener", default=None)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Count the seconds inside under a name, where somebody collects them, and announce it; 2 us where nobody does."""
    announce(name.partition(" ")[2] or name)
    start = perf_counter()
    try:
        with _inside(_INSIDE, True):
            yield
    finally:
        seconds = _SECONDS.get()
        if seconds is not None:
            seconds[name] = seconds.get(name, 0.0) + perf_counter() - start


@contextmanager
def _inside(variable: ContextVar[T | None], value: T) -> Iterator[T]:
    """A context variable of this thread has a value inside."""
    token = variable.set(value)
    try:
        yield value
    finally:
        variable.reset(token)


def collected() -> AbstractContextManager[dict[str, float]]:
    """Seconds by stage of everything called inside, by this thread.

    Examples
    --------
    >>> with collected() as seconds:
    ...     with stage("first"), stage("second"):
    ...         pass
    >>> sorted(seconds), seconds["first"] >= seconds["second"] >= 0
    (['first', 'second'], True)
    """
    return _inside(_SECONDS, {})


def inside_stage() -> bool:
    """Whether a stage is under way here, which Ctrl-C ends as a whole."""
    return bool(_INSIDE.get())


def announce(words: str) -> None:
    """How far a long stage is, for whoever listens; without words: something is printed now."""
    if (listener := _LISTENER.get()) is not None:
        listener(words)


def listened(listener: Callable[[str], object]) -> AbstractContextManager[object]:
    """Call the listener with all that is announced inside, by this thread.

    Examples
    --------
    >>> with listened(print):
    ...     announce("round 3")
    round 3
    """
    return _inside(_LISTENER, listener)
