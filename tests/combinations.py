"""Tests over every combination of some choices, as one test that names the combination at which it fails."""

from __future__ import annotations

import functools
import inspect
import itertools
from collections.abc import Callable, Iterable


def for_all(**choices: Iterable[object]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test with every combination of some of its arguments; pytest gives the others."""
    combinations = [dict(zip(choices, c, strict=True)) for c in itertools.product(*choices.values())]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(**arguments: object) -> None:
            for combination in combinations:
                try:
                    test(**arguments, **combination)
                except Exception as error:
                    error.add_note(f"with {', '.join(f'{name}={value}' for name, value in combination.items())}")
                    raise

        signature = inspect.signature(test)
        left = [parameter for name, parameter in signature.parameters.items() if name not in choices]
        run.__signature__ = signature.replace(parameters=left)  # type: ignore[attr-defined]
        return run

    return decorate
