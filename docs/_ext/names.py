"""The directive ``names``: a table of public names, each with its first sentence and a page of its own.

A line is ``module: names``; ``*`` stands for all public classes and functions of the module. Before pages are read,
`write` makes one for each name and each module in ``reference/class``, ``function``, ``data`` and ``module``. Autodoc
fills them. None of these files is kept in the repository.
"""

from __future__ import annotations

import inspect
import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from docutils import nodes
from jinja2.sandbox import SandboxedEnvironment
from numpydoc import docscrape_sphinx
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective, SphinxRole

__all__ = ["Names", "listed", "setup"]

TABLE = re.compile(r"^```\{names\}\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
LINE = re.compile(r"^(\S+):(.*(?:\n .*)*)$", flags=re.MULTILINE)
KINDS = ("class", "function", "data", "module")
SIDEBARS: dict[str, str] = {}  # by package
FOREIGN = "object, BaseException, ImportError, str, int, tuple, Enum"  # Python documents their attributes


def listed(text: str) -> dict[str, list[str]]:
    r"""Names by module, as the tables of a page have them.

    Examples
    --------
    >>> listed("```{names}\nnls: load FactorGraph\n  FactorGraph.optimize\nnls.gauge:\n```")
    {'nls': ['load', 'FactorGraph', 'FactorGraph.optimize'], 'nls.gauge': []}
    """
    found: dict[str, list[str]] = {}
    for table in TABLE.findall(text):
        for module, names in rows(table):
            found.setdefault(module, []).extend(names)
    return found


def rows(table: str) -> list[tuple[str, list[str]]]:
    """Lines of a table: a module and its names."""
    return [
        (module, _all(module) if names.split() == ["*"] else names.split()) for module, names in LINE.findall(table)
    ]


def _all(name: str) -> list[str]:
    module = import_module(name)
    own = [n for n, v in vars(module).items() if n[0] != "_" and getattr(v, "__module__", "") == name and callable(v)]
    return list(getattr(module, "__all__", own))


def _object(module: str, name: str) -> Any:
    value = import_module(module)
    for part in name.split("."):
        value = getattr(value, part)
    return value


def _kind(value: object) -> str:
    if isinstance(value, ModuleType):
        return "module"
    return "class" if inspect.isclass(value) else "function" if inspect.isroutine(value) else "data"


def _first_sentence(value: object) -> str:
    paragraph = " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())
    return re.split(r"(?<=[.]) (?=[A-Z`])", paragraph)[0]


def _is_exception(value: object) -> bool:
    return inspect.isclass(value) and issubclass(value, BaseException)


def _page(name: str, value: object, modules: list[str], bases: list[str]) -> str:
    """Source of the page of a name, as imported from the last module; modules and bases have pages of their own."""
    kind, module = _kind(value), modules[-1]
    links = [f":py:mod:`{other}`" for other in dict.fromkeys([module.partition(".")[0], *modules])]
    lines = [":orphan:", "", name, "=" * len(name), "", " › ".join([*links, f"``from {module} import {name}``"]), ""]
    lines += [f".. auto{'exception' if _is_exception(value) else kind}:: {module}.{name}"]
    if kind == "class":
        stops = ", ".join([FOREIGN, *(base.rpartition(".")[2] for base in bases)])
        lines += ["   :members:", f"   :inherited-members: {stops}"]
    lines += ["   :no-value:"] * (kind == "data")
    if bases:
        lines += ["", "Further attributes and methods: " + ", ".join(f":py:class:`~{base}`" for base in bases) + "."]
    return "\n".join([*lines, ""])


def _module_page(module: str, names: list[str]) -> str:
    way = f":py:mod:`{module.partition('.')[0]}` › ``import {module}``"
    lines = [":orphan:", "", module, "=" * len(module), "", way, "", f".. automodule:: {module}", ""]
    lines += [".. names::", "", f"   {module}: {' '.join(names)}", ""] if names else []
    return "\n".join(lines)


def pages(folder: Path) -> dict[str, str]:
    """Sources by path, for all names that the pages of a folder list."""
    found: dict[str, list[str]] = {}
    for path in sorted(folder.glob("*.md")):
        for module, names in listed(path.read_text(encoding="utf-8")).items():
            found.setdefault(module, []).extend(n for n in names if n not in found.get(module, []))
    objects = {f"{module}.{name}": (module, name, _object(module, name)) for module in found for name in found[module]}
    classes = {id(value): full for full, (_, _, value) in reversed(objects.items()) if inspect.isclass(value)}
    out = {}
    for full, (module, name, value) in objects.items():
        kind = _kind(value)
        if kind != "module" and "." not in name:
            bases = [classes[id(b)] for b in value.__mro__[1:] if id(b) in classes] if kind == "class" else []
            defined = [m for m in [getattr(value, "__module__", "")] if m in found]
            out[f"{kind}/{full}.rst"] = _page(name, value, [*defined, module], bases)
    packages = {path.stem for path in folder.glob("*.md")}
    out |= {
        f"module/{module}.rst": _module_page(module, names) for module, names in found.items() if module not in packages
    }
    return out


def write(app: Sphinx) -> None:
    """Write the pages that are new or changed, remove those of names that left."""
    folder = Path(app.srcdir) / "reference"
    texts = pages(folder)
    for kind in KINDS:
        (folder / kind).mkdir(exist_ok=True)
    for path in (path for kind in KINDS for path in (folder / kind).glob("*.rst")):
        if path.relative_to(folder).as_posix() not in texts:
            path.unlink()
    for name, text in texts.items():
        if not (folder / name).exists() or (folder / name).read_text(encoding="utf-8") != text:
            (folder / name).write_text(text, encoding="utf-8")


class Names(SphinxDirective):
    """The table."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        folder, _, here = self.env.docname.rpartition("/")
        body, below = nodes.tbody(), []
        for module, names in rows("\n".join(self.content)):
            if module != here:
                body += self._row(module, import_module(module), module, ["module"] * ("." in module))
                below.append(f"{folder}/module/{module}")
            for name in names:
                value = _object(module, name)
                full = value.__name__ if isinstance(value, ModuleType) else f"{module}.{name}"
                body += self._row(full, value, name, [])
                below.append(f"{folder}/{_kind(value)}/{full}")
        if folder == "reference":  # previous and next of a page follow the tables; the sidebar lists no names
            pages = [page for page in below if page in self.env.found_docs]
            self.env.toctree_includes.setdefault(self.env.docname, []).extend(pages)
        columns = [nodes.colspec(colwidth=width) for width in (26, 74)]
        return [nodes.table("", nodes.tgroup("", *columns, body, cols=2), classes=["names"])]

    def _row(self, full: str, value: object, shown: str, classes: list[str]) -> nodes.row:
        link = pending_xref(
            "", nodes.literal(text=shown), refdomain="py", reftype="obj", reftarget=full, refexplicit=True, refwarn=True
        )
        link["refdoc"] = self.env.docname
        text, _ = self.parse_inline(_first_sentence(value), lineno=self.lineno)
        cells = [nodes.paragraph("", "", link), nodes.paragraph("", "", *text)]
        return nodes.row("", *(nodes.entry("", cell) for cell in cells), classes=classes)


class Name(SphinxRole):
    """Text between single backticks of a docstring: a link if it names what has a page, and italics if not."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        shown = nodes.emphasis(text=self.text)
        here = {key: self.env.ref_context.get(key) for key in ("py:module", "py:class")}
        room = sys.modules.get(f"{here['py:module']}.{self.text}")  # `gauge` is the argument, not `nls.gauge`
        if room or not re.fullmatch(r"[A-Za-z_][\w.]*", self.text):
            return [shown], []
        domain = {"refdomain": "py", "reftype": "obj", "refdoc": self.env.docname}
        return [pending_xref("", shown, reftarget=self.text, only_if_found=True, **domain, **here)], []


def elsewhere(app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.TextElement) -> nodes.Element | None:
    """Link of a `Name` that its own module does not have: to a public class of a package, or none."""
    if not node.get("only_if_found"):
        return None
    target, domain = node["reftarget"], env.domains["py"]
    for package in ("factors", "models", "nls"):
        if target[0].isupper() and target.partition(".")[0] in import_module(package).__all__:
            full = f"{package}.{target}"
            return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", full, node, shown) or shown
    return shown


def sidebar(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: object) -> None:
    """Give all pages of a package's names the same list of pages, with the package open: it is made once."""
    folder, _, name = pagename.rpartition("/")
    if folder in {f"reference/{kind}" for kind in KINDS}:
        package, tree = name.partition(".")[0], context["toctree"]
        above = re.compile(
            rf'(class="toctree-l\d)("><a class="reference internal" href="\.\./(?:index|{package})\.html")'
        )

        def once(**options: Any) -> str:
            if package not in SIDEBARS:
                SIDEBARS[package] = above.sub(r"\1 current\2", tree(**options))
            return SIDEBARS[package]

        context["toctree"] = once


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("names", Names)
    app.add_role("name", Name())
    app.connect("missing-reference", elsewhere)
    app.connect("builder-inited", write, priority=100)  # before other extensions read the pages that are there
    app.connect("html-page-context", sidebar, priority=400)  # before the theme draws it
    # numpydoc compiles its template again for each docstring
    kept: dict[str, SandboxedEnvironment] = {}
    docscrape_sphinx.SandboxedEnvironment = lambda loader: kept.setdefault("", SandboxedEnvironment(loader=loader))
    return {"parallel_read_safe": True}
