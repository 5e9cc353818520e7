"""Smoothing as measurements arrive: the whole trajectory near its optimum after every update."""

from nls.incremental.incremental import Incremental

__all__ = ["Incremental"]
