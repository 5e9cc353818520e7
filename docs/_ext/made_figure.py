"""The directive ``made-figure``: a picture or an animation that a script of docs/figures makes when the site is built.

A script is a module with a docstring, whose first line is the alternative text, a sentence, and a function
``make() -> (figures, seconds)``: the frames, and how long each is shown; one frame is a picture. An animation has the
player of the notebooks, `nls.plot.animation`.
"""

from __future__ import annotations

import runpy
import time
from pathlib import Path
from typing import Any

from docutils import nodes
from matplotlib import rc_context
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from nls.plot.player import Animation, image

__all__ = ["MadeFigure", "setup"]

TEXT = 12  # points; a phone shows a figure at half its width
MADE = Path("_build") / "figures"  # below the pages; not part of the tree


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
            frames = [image(figure) for figure in figures]
        out, alt = nodes.figure(classes=["made"]), made["__doc__"].split("\n\n")[0].replace("\n", " ")
        if len(frames) > 1:
            player = Animation(frames, seconds, alt)
            out += nodes.raw("", player.html, format="html")
            size = len(player.html)
        else:
            path = Path(self.env.srcdir) / MADE / f"{source.stem}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            frames[0].save(path, optimize=True)
            size = path.stat().st_size
            out += nodes.image(
                uri=f"/{(MADE / path.name).as_posix()}", alt=alt, loading="lazy", width=f"{frames[0].width}px"
            )
        caption = self.parse_text_to_nodes("\n".join(self.content))
        out += nodes.caption("", "", *caption[0].children)
        spent = f"{source.name}: {len(frames)} frames, {size / 1e3:.0f} kB, {time.perf_counter() - began:.1f} s"
        logging.getLogger(__name__).info("made-figure: %s", spent)
        script = f"Made by `docs/figures/{source.name}`."
        return [out, *self.parse_text_to_nodes(script)]


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("made-figure", MadeFigure)
    return {"parallel_read_safe": True}
