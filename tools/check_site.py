"""Checks the built site: links, anchors, pictures, and that no page needs the network.

    python tools/check_site.py docs/_build/html

Every link inside the site leads to a file that is there and to an anchor in it; every picture is there and has a text;
no script, style sheet, font or picture is loaded over http; no page exceeds 1.5 MB with its pictures; a page with
equations loads MathJax from the site; no page shows the source of a table; every page of benchmarks/results is on the
site. In the sources, every link has a text: a code host shows nothing for a link without one. Prints what is wrong, a
line each; the exit status is 1 if anything is.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

RESULTS = Path(__file__).parents[1] / "benchmarks" / "results"
DOCS = Path(__file__).parents[1] / "docs"
LOADED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "video": "src"}
NEEDED = {"stylesheet", "preload", "icon", "modulepreload"}  # links that a browser follows by itself
PATH = re.compile(r"^\S*[/.]\S*$")  # a file name is no text
HEAVIEST = 1_500_000  # bytes of a page with its pictures; what all pages share is loaded once
TABLE = re.compile(r"<p>\|[^<]*\n\|-{3}")  # Markdown that nobody has turned into a table
NO_TEXT = re.compile(r"(?<!!)\[\]\(([^)]*)\)")  # a link that takes the title of its page


class Page(HTMLParser):
    """What a page refers to, and what can be referred to in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.pictures: list[tuple[str, str]] = []  # source, text
        self.math = 'class="math' in text
        self.raw = TABLE.search(text) is not None
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attributes}
        self.anchors |= {found[name] for name in ("id", "name") if name in found}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        if tag == "img":
            self.pictures.append((found.get("src", ""), found.get("alt", "")))
        if found.get(LOADED.get(tag, "")):
            self.loaded.append(found[LOADED[tag]])
        if tag == "link" and NEEDED & set(found.get("rel", "").split()):
            self.loaded.append(found.get("href", ""))


def problems(root: Path) -> Iterator[str]:
    """One sentence for everything that is wrong."""
    pages = {
        path.resolve(): Page(path.read_text(encoding="utf-8"))
        for path in sorted(root.rglob("*.html"))
        if "_static" not in path.parts
    }
    if not pages:
        yield f"{root}: there are no pages; build them first: make docs"
    for path, page in pages.items():
        name = path.relative_to(root.resolve())
        for link in page.links:
            yield from (f"{name}: {said}" for said in _broken(link, path, pages))
        for source in page.loaded:
            parts = urlsplit(source)
            if parts.scheme in ("http", "https") or parts.netloc:
                yield f"{name}: loads {source} from the network"
            elif parts.path and not parts.scheme and not (path.parent / unquote(parts.path)).exists():
                yield f"{name}: loads {source}, which is not there"
        pictures = {path.parent / unquote(source) for source, _ in page.pictures if not source.startswith("data:")}
        weight = sum(file.stat().st_size for file in {path, *pictures} if file.exists())
        if weight > HEAVIEST:
            yield f"{name}: takes {weight:,} bytes with its pictures, at most {HEAVIEST:,}: fewer or smaller pictures"
        for source, text in page.pictures:
            if not text or PATH.match(text):
                yield f"{name}: the picture {source[:80]} has no text (alt)"
        if page.raw:
            yield f"{name}: shows the source of a table"
        if page.math and not any("mathjax" in source.lower() for source in page.loaded):
            yield f"{name}: has equations, but does not load MathJax"
    for style in sorted(root.rglob("*.css")):
        text = re.sub(r"/\*.*?\*/", "", style.read_text(encoding="utf-8"), flags=re.DOTALL)
        for url in re.findall(r"""url\(\s*["']?(https?://[^)"']+)|@import\s+["'](https?://[^"']+)""", text):
            yield f"{style.relative_to(root)}: loads {''.join(url)} from the network"
    for result in sorted(RESULTS.glob("*.md")):
        if not (root / "benchmarks" / f"{result.stem}.html").exists():
            yield f"benchmarks/results/{result.name} has no page: add docs/benchmarks/{result.name}, which includes it"
    for path in (path for pattern in ("*.md", "*/*.md", "*/*.ipynb") for path in sorted(DOCS.glob(pattern))):
        for link in NO_TEXT.findall(path.read_text(encoding="utf-8")):
            yield f"docs/{path.relative_to(DOCS).as_posix()}: the link to {link} has no text: write [text]({link})"


def _broken(link: str, path: Path, pages: dict[Path, Page]) -> Iterator[str]:
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if not target.exists():
        yield f"the link {link} leads nowhere"
    elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
        yield f"the link {link} has no such anchor"


def main() -> int:
    """Prints what is wrong with the site that the first argument names."""
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    found = list(dict.fromkeys(problems(Path(sys.argv[1]))))
    print("\n".join(found) if found else "the site is whole")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
