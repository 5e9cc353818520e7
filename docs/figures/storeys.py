"""The storeys of nls from the roof down and who imports whom: imports go down, none goes up.

Rooms are boxes as wide as they have lines of code. The picture is drawn from the sources when the site is built.
"""

from __future__ import annotations

import runpy
from collections import Counter
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from nls.plot.style import ESTIMATE, LANDMARK, REJECTED, SIGHT

ROOMS = Path(__file__).parents[2] / "tools" / "rooms.py"
COLORS = (SIGHT, LANDMARK, ESTIMATE, "#6b4f2a")
NARROW, LEVEL, GAP = 420, 1700, 90  # lines of code: widths of boxes for a name upright and level; the space between


def make() -> tuple[list[Figure], list[float]]:
    """The picture."""
    made = runpy.run_path(str(ROOMS))
    storeys, rooms = made["STOREYS"], made["rooms"]()
    inside = {  # the parts of missions stand for the whole
        name: [part for room in names for part in sorted(p for p in rooms if p.startswith(f"{room}/")) or [room]]
        for name, names in storeys.items()
    }
    order = list(storeys)
    place = {room: k for k, names in enumerate(storeys.values()) for room in names}
    pairs = [
        (k, place[o]) for k, name in enumerate(order) for part in inside[name] for o in rooms[part].imports & {*place}
    ]
    down, up = Counter(a for a, b in pairs if b > a), Counter(a for a, b in pairs if b < a)
    figure = Figure(figsize=(10, 6.4), layout="constrained")
    axes = figure.subplots()
    ends = []
    for k, (name, color) in enumerate(zip(order, COLORS, strict=True)):
        y, x = -2.0 * k, 0.0
        for part in inside[name]:
            width = max(NARROW, rooms[part].lines)
            axes.add_patch(Rectangle((x, y), width, 1, color=color))
            label, turn = part.rpartition("/")[2], 90 if width < LEVEL else 0
            size = 8 if turn else 10  # the longest name fits the height of its box
            axes.text(
                x + width / 2, y + 0.5, label, color="white", ha="center", va="center", rotation=turn, fontsize=size
            )
            x += width + GAP
        ends.append(x)
        total = sum(rooms[room].lines for room in storeys[name])
        axes.text(-250, y + 0.5, f"{name}\n{total:,} lines", ha="right", va="center", color=color, weight="bold")
    for x, counts, ends_of, color in ((700, down, (0, -1), "black"), (3300, up, (1, 2), REJECTED)):
        for k, count in counts.items():
            start, end = (-2.0 * k + y for y in ends_of)
            arrow = FancyArrowPatch((x, start), (x, end), arrowstyle="-|>", mutation_scale=18, linewidth=2, color=color)
            axes.add_patch(arrow)
            axes.text(x + 150, (start + end) / 2, f"{count} import{'s' * (count > 1)}", va="center", color=color)
    axes.set(xlim=(-3200, max(ends)), ylim=(-6.2, 1.2))
    axes.set_axis_off()
    return [figure], [0.0]
