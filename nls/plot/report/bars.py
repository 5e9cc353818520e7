"""Small bars inside of tables, drawn in the colors of the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nls.plot.report.markup import Html, tag

__all__ = ["across", "bar"]

WIDTH, HEIGHT = 208, 20  # pixels
EDGE = 8  # on both sides of the scale
LEAST = 2.0  # the scale reaches at least so far on both sides of 1


def across(low: float, high: float, ratio: float, other_ratios: Sequence[float]) -> Html:
    """A band from `low` to `high`, a line at 1 and a dot at `ratio`, on a scale of logarithms.

    Parameters
    ----------
    low, high, ratio : around 1.
    other_ratios : all numbers of the table, which has one scale.
    """
    above = [other_ratio for other_ratio in other_ratios if other_ratio > 0]
    reach = max([float(np.log(LEAST)), *(abs(float(np.log(other_ratio))) for other_ratio in above)])

    def at(number: float) -> float:
        place = np.log(number) / reach if number > 0 else -1.0
        return round(float(WIDTH / 2 + (WIDTH / 2 - EDGE) * place), 1)

    color = "var(--good)" if low <= ratio <= high else "var(--hot)"
    begin, end, middle = at(low), at(high), HEIGHT / 2
    return tag(
        "svg",
        tag("line", x1=EDGE, x2=WIDTH - EDGE, y1=middle, y2=middle, stroke="var(--line)"),
        tag("rect", x=begin, y=4, width=round(max(end - begin, 2.0), 1), height=HEIGHT - 8, fill="var(--line)"),
        tag("line", x1=at(1.0), x2=at(1.0), y1=2, y2=HEIGHT - 2, stroke="var(--quiet)"),
        tag("circle", cx=at(ratio), cy=middle, r=5, fill=color),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        **{"aria-label": f"{ratio:.3g}, where {low:.3g} to {high:.3g} is expected"},
    )


def bar(share: float) -> Html:
    """A bar of a part of the width, between 0 and 1."""
    length = max(round(WIDTH * share, 1), 1.0)
    return tag(
        "svg",
        tag("rect", x=0, y=4, width=length, height=HEIGHT - 8, fill="var(--ink)"),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        **{"aria-hidden": "true"},
    )
