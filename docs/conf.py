"""Configuration of the site; `make docs` builds it with every warning fatal."""

import os
import sys
import tomllib
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from docutils.nodes import document
from docutils.parsers.rst.states import Inliner
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])  # nls in shell cells

project = "leadline"
author = "the leadline developers"
copyright = "2026, the leadline developers"
release = version = installed_version("leadline")

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    # MathJax and its fonts as an ordinary pip dependency, copied into the build: equations need no network and no npm.
    "sphinx-mathjax-offline",
    "factor_table",  # docs/_ext, to the end of the list
    "figure_alt",
    "forked_kernels",
    "format_table",
    "gallery",
    "line_breaks",
    "made_figure",
    "names",
    "notebook_download",
    "overview",
    "shell_cells",
    "small_pictures",
]
exclude_patterns = ["_build", "jupyter_execute", "**.ipynb_checkpoints"]  # pictures may lie below _build

# --- pages and notebooks ---
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True
nb_render_markdown_format = "gfm"  # of outputs: CommonMark has no tables
nb_ipywidgets_js = {}  # a slider needs a kernel, and the pages load nothing over the network

# --- reference ---
autodoc_member_order = "groupwise"
autodoc_typehints = "none"  # shapes and units in the docstrings say more than NDArray[float64]
toc_object_entries_show_parents = "hide"  # the title of the page is the class
default_role = "name"  # of docstrings: `Result` is a link
numpydoc_show_class_members = False  # autodoc lists them already
# |b|^2 in a docstring is a norm: take the bar as it stands, not as the start of one of docutils' substitutions
Inliner.dispatch["|"] = lambda self, match, lineno: (
    match.string[: match.end("start")],
    [],
    match.string[match.end("start") :],
    [],
)

# --- looks ---
html_theme = "sphinx_book_theme"
html_title = f"leadline {release}"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_context = {"default_mode": "auto"}  # light or dark as the reader's system is
html_theme_options = {
    "show_toc_level": 2,
    "use_download_button": False,
    "use_fullscreen_button": False,
    "navbar_persistent": [],  # the search box is in the sidebar; one is enough
}
if repository := tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"].get("urls"):
    html_theme_options |= {"repository_url": repository["Repository"], "use_repository_button": True}
mathjax3_config = {
    "tex": {
        "macros": {
            "Exp": r"\operatorname{Exp}",
            "Log": r"\operatorname{Log}",
            "Ad": r"\operatorname{Ad}",
            "diag": r"\operatorname{diag}",
            "wrap": r"\operatorname{wrap}",
            "argmin": r"\operatorname*{arg\,min}",
            "argmax": r"\operatorname*{arg\,max}",
            "T": r"^{\mathsf T}",
            "norm": [r"\lVert #1 \rVert", 1],
            "skew": [r"\left[ #1 \right]_\times", 1],
        }
    }
}


# --- pages are read in parallel: make docs passes -j ---
def spread(app: Sphinx, env: BuildEnvironment, docnames: list[str]) -> None:
    """Every fourth page together: a process is handed neighbors, and the slow ones, notebooks, are neighbors."""
    docnames[:] = [name for first in range(4) for name in docnames[first::4]]


# --- tables of measurements and the first page want the room that the contents of a page take ---
def widen(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: document | None) -> None:
    """Benchmarks and the first page have no second sidebar."""
    if pagename == "index" or pagename.startswith("benchmarks/"):
        context["secondary_sidebar_items"] = []


# --- the fields of a named tuple are among its attributes already ---
def skip(app: Sphinx, what: str, name: str, found: object, skipped: bool, options: object) -> bool | None:
    """Whether a member is left out of the reference."""
    return True if (getattr(found, "__doc__", None) or "").startswith("Alias for field number") else None


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-skip-member", skip)
    app.connect("html-page-context", widen, priority=900)
    app.connect("env-before-read-docs", spread)
    # It copies MathJax when the build is finished and has no part in reading, which it does not say.
    app.extensions["sphinx-mathjax-offline"].parallel_read_safe = True
