"""Numbers about a graph and its optimum, without sentences."""

from nls.analysis.redundancy import Unverified, unverified_groups

__all__ = ["Unverified", "unverified_groups"]
