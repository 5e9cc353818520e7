"""Lists sentences of the project's texts that are hard to read.

    python tools/plain.py                        # one line a page or source file, then the candidates of each
    python tools/plain.py README.md docs/start.md
    python tools/plain.py --before COMMIT --out benchmarks/results/words.md     # as the texts were, beside today's

A candidate has more than 25 words, or *what*, *that* or *it* as its subject. Read are the Markdown pages, the Markdown
cells of notebooks, docstrings of public names and the help texts of the commands. Left out are code, equations and
tables. The list informs; a candidate is no error.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import io
import json
import re
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "docs/*.md", "docs/how-to/*.md", "docs/reference/*.md", "docs/theory/*.md", "docs/notebooks/*")
SOURCES = tuple(f"{package}/**/*.py" for package in ("models", "factors", "nls", "sim"))
LONG = 25  # words
SUBJECT = re.compile(r"^(?:and |but |so |or |then |all )?(what|that|it)\b", re.IGNORECASE)
FENCE = re.compile(r"^(`{3,}|~{3,}).*?^\1\s*$", re.MULTILINE | re.DOTALL)
FRONT = re.compile(r"\A---\n.*?^---\n", re.MULTILINE | re.DOTALL)
MATH = re.compile(r"\$\$.*?\$\$", re.DOTALL)
INLINE = [(re.compile(r"\$[^$\n]+\$"), "x"), (re.compile(r"`+([^`]*)`+"), "x"), (re.compile(r"\{[a-z:]+\}"), "")]
INLINE += [(re.compile(r"!?\[([^\]]*)\]\([^)]*\)"), r"\1"), (re.compile(r"[*_]{1,2}(?=\S)|(?<=\S)[*_]{1,2}"), "")]
BLOCK = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*+]|\d+\.)\s)|\n(?=\s*\|)|\n(?=#)")
END = re.compile(r"(?<=[A-Za-z0-9)\]\"'x`%][.!?])\s+(?=[\w\"'(`])|(?<=:)\s+(?=[A-Z])|(?<=;)\s+")
DOT = re.compile(r"\b(e\.g|i\.e|cf|vol|pp|no|eq|fig|sec)\.", re.IGNORECASE)


def sentences(text: str) -> list[str]:
    """The sentences of Markdown or of a docstring, without code, equations, tables and headings."""
    for pattern in (FRONT, FENCE, MATH):
        text = pattern.sub("\n\n", text)
    out = []
    for block in BLOCK.split(text):
        if re.match(r"\s*(#|\||>>>|\.\.\s|:::|<|-{3,}|={3,})", block):
            continue
        line = " ".join(block.split())
        for pattern, plain in INLINE:
            line = pattern.sub(plain, line)
        line = re.sub(r"^(?:[-*+]|\d+\.)\s+", "", DOT.sub(r"\1", line))
        out += [part.strip() for part in END.split(line) if re.search(r"[A-Za-z]{2}", part)]
    return out


def words(sentence: str) -> int:
    """Number of words, numbers among them."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def docstring_text(docstring: str) -> str:
    """The prose of a numpydoc docstring: no examples, no indented equations, no section titles."""
    text = re.sub(r"^(\w[\w ]*)\n-{3,}$", "", docstring, flags=re.MULTILINE)
    text = re.split(r"^\s*>>>", text, flags=re.MULTILINE)[0]
    lines = [line for line in text.splitlines() if not re.match(r"\s{4,}\S.*\s{2,}\S|.*\s=\s", line)]
    return re.sub(r"^(\S[^\n:]{0,40}) : ", "\n", "\n".join(lines), flags=re.MULTILINE)


def source_text(path: Path) -> Iterator[str]:
    """Docstrings of the module and of public names, and the texts given as ``help``."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for node in ast.walk(tree):
        if isinstance(node, documented) and not getattr(node, "name", "module").startswith("_"):
            yield docstring_text(ast.get_docstring(node) or "")
        if isinstance(node, ast.keyword) and node.arg in ("help", "description", "epilog"):
            yield from (n.value for n in [node.value] if isinstance(n, ast.Constant) and isinstance(n.value, str))


def texts(path: Path) -> str:
    """All that a person reads of a file."""
    if path.suffix == ".py":
        return "\n\n".join(source_text(path))
    if path.suffix == ".ipynb":
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return path.read_text(encoding="utf-8")


def candidates(sentences: list[str]) -> list[str]:
    """The sentences that are long or begin with a pronoun, the longest first."""
    return sorted((s for s in sentences if words(s) > LONG or SUBJECT.match(s)), key=words, reverse=True)


def all_paths(root: Path) -> list[Path]:
    """Every page and source file of a tree."""
    return [path for pattern in (*PAGES, *SOURCES) for path in sorted(root.glob(pattern)) if path.is_file()]


def counted(root: Path) -> dict[str, list[int]]:
    """Words of each sentence, page by page; the docstrings of a package are one page."""
    pages: dict[str, list[int]] = {}
    for path in all_paths(root):
        name = path.relative_to(root)
        title = f"docstrings of `{name.parts[0]}`" if path.suffix == ".py" else f"`{name.as_posix()}`"
        pages.setdefault(title, []).extend(words(s) for s in sentences(texts(path)))
    return {title: counts for title, counts in pages.items() if counts}


def comparison(before: dict[str, list[int]], after: dict[str, list[int]]) -> list[str]:
    """A row a page: words, the longest sentence, and the number of those above `LONG`, before and after."""
    lines = ["| page | words before | after | longest before | after | above 25 before | after |", "|:--|" + "--:|" * 6]
    total = [[n for counts in pages.values() for n in counts] for pages in (before, after)]
    rows = {title: [before.get(title), after.get(title)] for title in {**after, **before}} | {"**all**": total}
    for title, pair in rows.items():
        measures = (sum, max, lambda counts: sum(n > LONG for n in counts))
        cells = [f"{measure(counts):,}" if counts else "" for measure in measures for counts in pair]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return lines


def earlier(commit: str) -> dict[str, list[int]]:
    """What `counted` finds in the tree of a commit."""
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive)) as tree:
        tree.extractall(folder, filter="data")
        return counted(Path(folder))


def report(commit: str) -> list[str]:
    """The page of the results."""
    dated = ["git", "log", "-1", "--format=%h, %cs", commit]
    named = subprocess.run(dated, cwd=ROOT, capture_output=True, check=True, text=True).stdout.strip()
    return [
        "# Words and the longest sentences, before and after",
        "",
        *comparison(earlier(commit), counted(ROOT)),
        "",
        f"- before: commit {named}; after: {datetime.date.today():%Y-%m-%d}",
        f"- words of sentences, without code, equations, tables and headings; above {LONG}: sentences of more words",
        "- a new or removed page has an empty cell; only docstrings of public names count",
        "- `tools/plain.py` lists the sentences themselves",
    ]


def main() -> None:
    """Prints the table, then the candidates page by page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="all pages and sources when omitted")
    parser.add_argument("--before", metavar="COMMIT", help="compare all pages with those of this commit")
    parser.add_argument("--out", type=Path, help="the page that --before writes; printed when omitted")
    options = parser.parse_args()
    if options.before:
        text = "\n".join(report(options.before)) + "\n"
        if options.out:
            options.out.write_text(text, encoding="utf-8")
        else:
            print(text, end="")
        return
    pages = [(path, sentences(texts(path))) for path in options.files or all_paths(ROOT)]
    print("  words  longest  above 25  pronoun subject  page")
    total = [0, 0, 0]
    for path, listed in pages:
        counts = [words(s) for s in listed]
        row = [sum(counts), sum(n > LONG for n in counts), sum(bool(SUBJECT.match(s)) for s in listed)]
        total = [a + b for a, b in zip(total, row, strict=True)]
        name = path.relative_to(ROOT) if path.is_absolute() else path
        print(f"{row[0]:7,d} {max(counts, default=0):8d} {row[1]:9d} {row[2]:16d}  {name}")
    print(f"{total[0]:7,d} {'':8} {total[1]:9d} {total[2]:16d}  all")
    for path, listed in pages:
        if chosen := candidates(listed):
            print(f"\n{path.relative_to(ROOT) if path.is_absolute() else path}")
            print("\n".join(f"  {words(s):3d}  {s}" for s in chosen))


if __name__ == "__main__":
    main()
