"""Contents of a graph, free directions, doubted measurements and cures, in plain words."""

from typing import TYPE_CHECKING, Any

from nls.explanation.findings import Explanation, Finding, FindingKind, Measurement, Part, Weak

if TYPE_CHECKING:
    from nls.explanation.explanation import explain

__all__ = ["Explanation", "Finding", "FindingKind", "Measurement", "Part", "Weak", "explain"]


def __getattr__(name: str) -> Any:
    """`explain`, which needs every analysis, when it is first asked for: findings of other rooms need none."""
    if name != "explain":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from nls.explanation.explanation import explain

    return explain
