"""Figures that move: the frames of a figure in one piece of HTML, with a player and a still picture."""

from __future__ import annotations

import html
import json
import math
from base64 import b64encode
from collections.abc import Callable, Iterable
from io import BytesIO
from string import Template
from typing import TYPE_CHECKING, TypeVar
from zlib import crc32

from models.errors import OptionError
from models.options import check_between
from nls.plot.picture import escape_controls

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

__all__ = ["Animation", "animation"]

LIMIT = 1_000_000  # bytes of an animation, so that a page with two loads on a slow line
DPI = 80
QUALITY = 80  # of a frame in WebP, of 100
PLAYER = Template("""\
<figure class="player" id="$name">
<img src="$still" alt="$alt" width="$width" height="$height" style="max-width: 100%; height: auto;">
<div hidden>
<button type="button" aria-label="play or pause">&#9654;</button>
<input type="range" min="0" max="$last" value="$last" aria-label="frame" style="width: 60%; vertical-align: middle;">
<output>$count / $count</output>
</div>
<script>
(() => {
  const player = document.getElementById("$name"), frames = $frames, seconds = $seconds;
  const [image, controls, button, slider, text] =
    ["img", "div", "button", "input", "output"].map((tag) => player.querySelector(tag));
  let timer = null;
  const show = (k) => {
    slider.value = k;
    image.src = "data:image/webp;base64," + frames[k];
    text.textContent = (k + 1) + " / " + frames.length;
  };
  const stop = () => { clearInterval(timer); timer = null; button.textContent = "\\u25b6"; };
  const step = () => (+slider.value < frames.length - 1 ? show(+slider.value + 1) : stop());
  button.onclick = () => {
    if (timer) return stop();
    if (+slider.value === frames.length - 1) show(0);
    button.textContent = "\\u23f8";
    timer = setInterval(step, 1000 * seconds);
  };
  slider.oninput = () => { stop(); show(+slider.value); };
  controls.hidden = false;
})();
</script>
</figure>
""")

T = TypeVar("T")


class Animation:
    """Frames that a notebook and a page play.

    Attributes
    ----------
    frames : every frame as WebP.
    still : the last frame as PNG, for programs that show no HTML.
    seconds : how long each is shown.
    alt : the text in place of the picture.
    html : the player: play and pause, a slider that arrow keys move, the last frame before anything plays. A reader
        without scripts sees the last frame alone. Nothing is loaded over the network.
    """

    def __init__(self, frames: list[bytes], still: bytes, size: tuple[int, int], seconds: float, alt: str) -> None:
        self.frames, self.still, self.seconds, self.alt = frames, still, seconds, alt
        codes = [b64encode(frame).decode() for frame in frames]
        self.html = PLAYER.substitute(
            name=f"player-{crc32(b''.join(frames)):x}",
            still=f"data:image/webp;base64,{codes[-1]}",
            alt=html.escape(alt),
            width=size[0],
            height=size[1],
            last=len(frames) - 1,
            count=len(frames),
            frames=json.dumps(codes),
            seconds=seconds,
        )

    def __repr__(self) -> str:
        return f"Animation({len(self.frames)} frames, {len(self.html) / 1e3:.0f} kB)"

    def _repr_html_(self) -> str:
        return self.html

    def _repr_png_(self) -> bytes:
        return self.still


def animation(
    figure: Figure, draw: Callable[[T], object], frames: Iterable[T], *, alt: str, seconds: float = 0.2
) -> Animation:
    """A figure drawn once for each frame, with a player.

    Parameters
    ----------
    figure : the figure that every frame is drawn in.
    draw : called as ``draw(frame)``; it changes what the figure shows, such as ``line.set_data(...)``.
    frames : what `draw` is called with, in order. The last one is the still picture.
    alt : a sentence that says what is to be seen, for readers who see no pictures.
    seconds : how long a frame is shown.

    Returns
    -------
    Animation
        The last value of a cell is shown. The figure is closed.

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
    from PIL.Image import frombytes

    check_between("seconds", seconds, 0, math.inf, "a time above 0, s")
    drawn: list[bytes] = []
    width, height = (int(DPI * inches) for inches in figure.get_size_inches())
    for frame in frames:
        draw(frame)
        escape_controls(figure)
        raw = BytesIO()
        figure.savefig(raw, format="rgba", dpi=DPI)
        image = frombytes("RGBA", (width, height), raw.getvalue()).convert("RGB")
        drawn.append(_encoded(image, "webp", quality=QUALITY, method=3))
    plt.close(figure)
    if not drawn:
        raise OptionError("frames", drawn, "at least one")
    made = Animation(drawn, _encoded(image, "png", optimize=True), image.size, seconds, alt)
    if len(made.html) > LIMIT:
        expected = f"at most {LIMIT:,} bytes, with fewer frames or a smaller figure; they take {len(made.html):,} bytes"
        raise OptionError("frames", len(drawn), expected)
    return made


def _encoded(image: Image.Image, kind: str, **options: object) -> bytes:
    """An image in the bytes of a file."""
    written = BytesIO()
    image.save(written, format=kind, **options)
    return written.getvalue()
