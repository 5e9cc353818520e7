"""Pictures of the site in 256 colors: a third of the bytes, and no color is off by more than a shade that eyes miss.

Figures are lines on white. Pillow's maximum coverage keeps rare colors, such as one thin red line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PIL import Image
from sphinx.application import Sphinx

__all__ = ["setup", "shrink"]


def shrink(path: Path) -> None:
    """Write a PNG with 256 colors on white, unless it has a palette."""
    with Image.open(path) as picture:
        if picture.mode == "P":
            return
        drawn = picture.convert("RGBA")
    white = Image.new("RGBA", drawn.size, "white")
    flat = Image.alpha_composite(white, drawn).convert("RGB")
    flat.quantize(256, Image.Quantize.MAXCOVERAGE).save(path)


def _shrink_all(app: Sphinx, exception: Exception | None) -> None:
    """All pictures of the pages that were written."""
    for path in (Path(app.outdir) / "_images").glob("*.png"):
        shrink(path)


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("build-finished", _shrink_all)
    return {"parallel_read_safe": True}
