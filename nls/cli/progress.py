"""A line on a terminal that moves while something is solved."""

from __future__ import annotations

import sys
from typing import Any

import nls
from models.visible import visible


class Progress:
    """A line on standard error where that is a terminal, gone at the end; nothing elsewhere.

    Parameters
    ----------
    title : is done.
    most : iterations, as far as that is known.
    quiet : nothing on a terminal either.
    late : nothing before the first step, where most inputs take none.
    """

    def __init__(self, title: str, most: int | None = None, quiet: bool = False, late: bool = False) -> None:
        self.bar: Any = None
        self.active = sys.stderr is not None and sys.stderr.isatty() and not quiet
        self.title, self.most, self.late = title, most, late

    def __enter__(self) -> Progress:
        if not self.late:
            self._open()
        return self

    def _open(self) -> None:
        """Begin the line, unless it has begun."""
        if self.active and self.bar is None:
            from tqdm import tqdm

            self.bar = tqdm(total=self.most, desc=self.title, unit="it", leave=False)

    def show(self, iteration: nls.Iteration) -> None:
        """One more iteration."""
        if self.bar is not None:
            self.bar.set_postfix_str(f"chi2 {iteration.chi2:.6g}")
            self.bar.update()

    def say(self, step: object) -> None:
        """One more step, in its own words."""
        self._open()
        if self.bar is not None:
            self.bar.set_postfix_str(visible(str(step)))
            self.bar.update()

    def next(self, title: str) -> None:
        """Something else is done now."""
        if self.bar is not None:
            self.bar.set_description_str(title)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
