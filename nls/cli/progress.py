"""A line on a terminal that moves while something is solved."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nls.optimizers import Iteration


class Progress:
    """A line on standard error where that is a terminal, gone at the end; nothing elsewhere.

    Parameters
    ----------
    title : is done.
    most : iterations, as far as that is known.
    quiet : nothing on a terminal either.
    """

    def __init__(self, title: str, most: int | None = None, quiet: bool = False) -> None:
        self.bar: Any = None
        self.active = sys.stderr.isatty() and not quiet
        self.title, self.most = title, most

    def __enter__(self) -> Progress:
        if self.active:
            from tqdm import tqdm

            self.bar = tqdm(total=self.most, desc=self.title, unit="it", leave=False)
        return self

    def show(self, iteration: Iteration) -> None:
        """One more iteration."""
        if self.bar is not None:
            self.bar.set_postfix_str(f"chi2 {iteration.chi2:.6g}")
            self.bar.update()

    def say(self, step: object) -> None:
        """One more step, in its own words."""
        if self.bar is not None:
            self.bar.set_postfix_str(str(step))
            self.bar.update()

    def next(self, title: str) -> None:
        """Something else is done now."""
        if self.bar is not None:
            self.bar.set_description_str(title)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
