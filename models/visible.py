"""Text as it is shown to people: what a terminal would obey, and no eye would see, is escaped."""

from __future__ import annotations

import re

__all__ = ["CONTROLS", "visible"]

# All controls but tab and newline, overrides of the direction of writing, and halves of characters, which names of
# files may have.
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def visible(text: str) -> str:
    r"""A text with its control characters escaped.

    Examples
    --------
    >>> print(visible("EDGE_\x1b]0;title\x07"), visible("\u202etxt.g2o"))
    EDGE_\x1b]0;title\x07 \u202etxt.g2o
    """
    return CONTROLS.sub(lambda match: match[0].encode("unicode_escape").decode(), text)
