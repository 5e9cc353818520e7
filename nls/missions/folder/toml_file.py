"""A TOML file that people write: its tree, and errors with the line of a key."""

import re
import tomllib
from pathlib import Path
from typing import Any, Self

from models.errors import GraphFileError
from nls.io.files import read_text


class TomlFile:
    """The tree of a file.

    Parameters
    ----------
    text : of the file.
    path : for messages.

    Attributes
    ----------
    tree : by section and key, as `tomllib.loads` gives it.

    Raises
    ------
    GraphFileError
        No TOML; says the line.

    Examples
    --------
    >>> file = TomlFile('[sonar]\\nx_m = "1"\\n', "mission.toml")
    >>> print(file.error("sonar", "x_m", "x_m is '1'; expected a number"))
    mission.toml:2: x_m is '1'; expected a number [x_m = "1"]
    """

    def __init__(self, text: str, path: str) -> None:
        self.text, self.path = text, path
        try:
            self.tree: dict[str, Any] = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # no TOML, or a number or a nesting beyond all bounds
            place = re.search(r" \(at line (\d+), column (\d+)\)", str(error))
            lines = text.split("\n")
            read = [*lines[: int(place[1]) - 1], lines[int(place[1]) - 1][: int(place[2]) - 1]] if place else lines
            behind = not place or "Unclosed" in str(error)  # it is noticed behind the last word
            line = len(("\n".join(read).rstrip().split("\n")) if behind else read)
            raise self._at(line, f"is no TOML: {str(error).split(' (at')[0]}") from error

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The file with a name.

        Raises
        ------
        GraphFileError
            It cannot be read, is not UTF-8 or no TOML.
        """
        return cls(read_text(path), str(path))

    def error(self, section: str, key: str, message: str, part: int = 0) -> GraphFileError:
        """An error at the line of a key of a section, or of the section; `part` counts those of one name from 0."""
        return self._at(self._place(section, key, part), message)

    def _at(self, line: int | None, message: str) -> GraphFileError:
        shown = self.text.split("\n")[line - 1].strip() if line else ""
        return GraphFileError(message, self.path, line, shown)

    def _place(self, section: str, key: str, part: int) -> int | None:
        """The line of a key; of one that is not in its section the line above all sections, or that of the section."""
        within, start, above, heads, here = "", None, None, 0, False
        quoted = rf"[\"']?{re.escape(key)}[\"']?"
        for k, line in enumerate(self.text.split("\n"), 1):
            has_key = bool(key) and re.match(rf"\s*{quoted}\s*[.=]", line) is not None
            if head := re.match(r"\s*\[\[?\s*[\"']?([\w-]+)[\"']?\s*\]\]?", line):
                within = head[1]
                heads += within == section
                here = within == section and heads == part + 1
                start = start or (k if here else None)
            elif not within and section and re.match(rf"\s*[\"']?{re.escape(section)}[\"']?\s*[.=]", line):
                start = start or k
                if key and re.search(rf"[.{{,]\s*{quoted}\s*[.=]", line):
                    return k
            elif has_key and here:
                return k
            elif has_key and not within:
                above = k
        return above or start
