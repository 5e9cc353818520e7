"""Figures that move: the frames of a figure in one piece of HTML, with a player and a still picture."""

from __future__ import annotations

import html
import json
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from io import BytesIO
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, TypeVar
from zlib import crc32

import numpy as np

from models.errors import OptionError
from nls.plot.picture import escape_controls

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image as Picture

LIMIT = 1_000_000  # bytes of an animation: a page with two loads on a slow line
DPI = 80
COLORS, MAXIMUM_COVERAGE = 64, 1  # of a frame; Pillow's method that keeps rare colors, such as a thin red line
PLAYER = Path(__file__).with_name("player.html")

T = TypeVar("T")


class Animation:
    """Frames that a notebook and a page play.

    Parameters
    ----------
    images : the frames. The last one is the still picture.
    seconds : how long each is shown, one number for all or one each.
    alt : a sentence that says what is to be seen, for readers who see no pictures.

    Attributes
    ----------
    frames : every frame as WebP.
    html : the player: play and pause, and a slider that the arrow keys move. It shows the last frame before it plays; a
        reader without scripts sees that frame alone. Nothing is loaded over the network.

    Raises
    ------
    OptionError
        No frames, or more than a million bytes of them; `seconds` not above 0.
    """

    def __init__(self, images: Sequence[Picture], seconds: float | Sequence[float], alt: str) -> None:
        if not images:
            raise OptionError("frames", images, "at least one")
        durations = np.asarray(seconds, float)
        if durations.size not in (1, len(images)) or not (np.isfinite(durations) & (durations > 0)).all():
            raise OptionError("seconds", seconds, "a time above 0 for all frames, or one for each")
        self._last = images[-1]
        self.frames = [_frame(image) for image in images]
        codes = [b64encode(frame).decode() for frame in self.frames]
        self.html = Template(PLAYER.read_text(encoding="utf-8")).substitute(
            name=f"player-{crc32(b''.join(self.frames)):x}",
            still=f"data:image/webp;base64,{codes[-1]}",
            alt=html.escape(alt),
            width=self._last.width,
            height=self._last.height,
            last=len(images) - 1,
            frames=json.dumps(codes),
            seconds=json.dumps(np.broadcast_to(durations, len(images)).tolist()),
        )
        if len(self.html) > LIMIT:
            expected = f"at most {LIMIT:,} bytes: fewer frames or a smaller figure; they take {len(self.html):,} bytes"
            raise OptionError("frames", len(images), expected)

    def __repr__(self) -> str:
        return f"Animation({len(self.frames)} frames, {len(self.html) / 1e3:.0f} kB)"

    def _repr_html_(self) -> str:
        return self.html

    def _repr_png_(self) -> bytes:
        """The last frame, for programs that show no HTML."""
        return _encoded(self._last, "png", optimize=True)


def animation(
    figure: Figure,
    draw: Callable[[T], object],
    frames: Iterable[T],
    *,
    alt: str,
    seconds: float | Sequence[float] = 0.2,
) -> Animation:
    """A figure drawn once for each frame, with a player.

    Parameters
    ----------
    figure : the figure that every frame is drawn in.
    draw : called as ``draw(frame)``; it changes what the figure shows, such as ``line.set_data(...)``.
    frames : what `draw` is called with, in order. The last one is the still picture.
    alt : a sentence that says what is to be seen, for readers who see no pictures.
    seconds : how long each frame is shown, one number for all or one each.

    Returns
    -------
    Animation
        As the last value of a cell it is shown. The figure is closed, so that it is not shown a second time.

    Raises
    ------
    OptionError
        No frames, or more than a million bytes of them; `seconds` not above 0.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from nls.plot import animation
    >>> figure, axes = plt.subplots(figsize=(4, 2))
    >>> (point,) = axes.plot([0], [0], "o")
    >>> moving = animation(figure, lambda x: point.set_xdata([x]), [-0.04, 0.0, 0.04], alt="A point moves.")
    >>> len(moving.frames), len(moving.html) < 1_000_000
    (3, True)
    """
    import matplotlib.pyplot as plt

    images = []
    for frame in frames:
        draw(frame)
        images.append(image(figure))
    plt.close(figure)
    return Animation(images, seconds, alt)


def image(figure: Figure) -> Picture:
    """A figure as an image on a white ground, 80 dots an inch."""
    from matplotlib import rc_context
    from PIL import Image

    escape_controls(figure)
    width, height = (int(DPI * inches) for inches in figure.get_size_inches())
    raw, size = BytesIO(), (width, height)
    with rc_context({"savefig.bbox": "standard"}):  # all frames have the size of the figure
        figure.savefig(raw, format="rgba", dpi=DPI)
    drawn, ground = Image.frombytes("RGBA", size, raw.getvalue()), Image.new("RGBA", size, "white")
    return Image.alpha_composite(ground, drawn).convert("RGB")


def _frame(image: Picture) -> bytes:
    """An image as WebP: 64 colors, which keep lines sharp, or a lossy picture of all colors where that is smaller."""
    few = image.quantize(COLORS, MAXIMUM_COVERAGE).convert("RGB")
    return min(_encoded(few, "webp", lossless=True), _encoded(image, "webp", quality=75, method=1), key=len)


def _encoded(image: Picture, kind: str, **options: object) -> bytes:
    """An image in the bytes of a file."""
    written = BytesIO()
    image.save(written, format=kind, **options)
    return written.getvalue()
