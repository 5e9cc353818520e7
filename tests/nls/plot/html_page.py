"""A page of HTML as a browser sees it, for the tests of reports."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from importlib import import_module

import pytest

OPEN = {"meta", "img"}  # elements that are not closed


class Page(HTMLParser):
    """What a browser sees; complains of everything that is not closed, not described or not inside."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.images: list[dict[str, str]] = []
        self.texts: list[str] = []
        self.headings: list[int] = []
        assert text.startswith('<!DOCTYPE html>\n<html lang="en">')
        self.feed(text)
        self.close()
        assert self.open == []
        assert set(self.links) == {f"#{name}" for name in self.ids}
        assert (self.headings[0], set(self.headings[1:])) == (1, {2})
        assert self.tags.count("table") == self.tags.count("caption")
        assert not {"script", "link", "iframe", "object"} & set(self.tags)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        said = {name: value or "" for name, value in attrs}
        self.tags.append(tag)
        assert not [name for name in said if name.startswith("on")]
        if "id" in said:
            assert said["id"] not in self.ids
            self.ids.add(said["id"])
        if tag == "a":
            self.links.append(said["href"])
        if tag == "img":
            assert re.match(r"data:image/(png|svg\+xml);base64,[A-Za-z0-9+/=]+$", said["src"])
            assert said["alt"].strip()
            self.images.append(said)
        if re.fullmatch(r"h\d", tag):
            self.headings.append(int(tag[1]))
        if tag not in OPEN:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] != ["style"]:
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.texts)


def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not rendered: that is most of the time of a page."""
    monkeypatch.setattr(import_module("nls.plot.report.markup"), "_drawn", lambda figure, kind: b"drawn")
