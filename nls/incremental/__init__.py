"""Smoothing as measurements arrive: the whole trajectory at its optimum after every update."""

from nls.incremental.incremental import Incremental

__all__ = ["Incremental"]
