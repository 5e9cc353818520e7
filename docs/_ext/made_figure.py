"""The directive ``made-figure``: a picture or an animation that a script of docs/figures makes when the site is built.

A script is a module with a docstring, whose first line is the alternative text, a sentence, and a function
``make() -> (figures, seconds)``: the frames, and how long each is shown; one frame is a picture. The pages show
animations as WebP, and the last frame to those whose system asks for no motion and on paper.
"""

from __future__ import annotations

import runpy
import time
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from docutils import nodes
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

__all__ = ["LIMIT", "MadeFigure", "animation", "frame", "setup"]

LIMIT = 1_500_000  # bytes
DPI = 80
TEXT = 12  # points; a phone shows a figure at half its width
MADE = Path("_build") / "figures"  # below the pages; not part of the tree


def frame(figure: Figure) -> Image.Image:
    """A figure as an image, on a white ground."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def animation(frames: Sequence[Image.Image], seconds: Sequence[float]) -> bytes:
    """An animated WebP that runs for ever."""
    written = BytesIO()
    milliseconds = np.round(1000 * np.asarray(seconds)).astype(int).tolist()
    options: dict[str, Any] = {"save_all": True, "append_images": frames[1:], "duration": milliseconds, "loop": 0}
    frames[0].save(written, format="webp", quality=80, method=3, **options)
    return written.getvalue()


class MadeFigure(SphinxDirective):
    """The figure; its content is the caption."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        source = Path(self.env.srcdir) / "figures" / f"{self.arguments[0]}.py"
        self.env.note_dependency(str(source))
        began = time.perf_counter()
        made = runpy.run_path(str(source))
        with rc_context({"font.size": TEXT, "axes.titlesize": TEXT + 1}):
            figures, seconds = made["make"]()
            frames = [frame(figure) for figure in figures]
        pictures = [(f"{source.stem}.png", _png(frames[-1]), "still" if len(frames) > 1 else "")]
        if len(frames) > 1:
            pictures.insert(0, (f"{source.stem}.webp", animation(frames, seconds), "moving"))
        out, alt = nodes.figure(classes=["made"]), made["__doc__"].split("\n\n")[0].replace("\n", " ")
        for name, content, what in pictures:
            if len(content) > LIMIT:
                raise ExtensionError(f"made-figure: {name} has {len(content)} bytes, at most {LIMIT} are wanted")
            path = Path(self.env.srcdir) / MADE / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            options = {"classes": [what] if what else [], "loading": "lazy", "width": f"{frames[-1].width}px"}
            out += nodes.image(uri=f"/{(MADE / name).as_posix()}", alt=alt, **options)
        caption = self.parse_text_to_nodes("\n".join(self.content))
        out += nodes.caption("", "", *caption[0].children)
        spent = f"{source.name}: {len(frames)} frames, {time.perf_counter() - began:.1f} s"
        sizes = ", ".join(f"{name} {len(content) / 1e3:.0f} kB" for name, content, _ in pictures)
        logging.getLogger(__name__).info("made-figure: %s: %s", spent, sizes)
        script = f"Made by `docs/figures/{source.name}`."
        return [out, *self.parse_text_to_nodes(script)]


def _png(image: Image.Image) -> bytes:
    written = BytesIO()
    image.save(written, format="png", optimize=True)
    return written.getvalue()


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("made-figure", MadeFigure)
    return {"parallel_read_safe": True}
