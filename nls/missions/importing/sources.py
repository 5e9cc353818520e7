"""Which log a section of a mapping is made from, each log read once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import GraphFileError, OptionError
from models.options import did_you_mean
from nls.missions.importing.bags import Bag, is_bag
from nls.missions.importing.mapping import Section
from nls.missions.importing.text_log import Log, TextLog

__all__ = ["Logs"]

READING = ("separator", "decimal", "header", "skip", "join")  # options of a section that say how its log is read


class Logs:
    """The logs that were given.

    Parameters
    ----------
    paths : of text files and bags.

    Raises
    ------
    OptionError
        Two of one name.
    """

    def __init__(self, paths: Sequence[str | Path]) -> None:
        self.paths = {Path(path).name: str(path) for path in paths}
        if len(self.paths) < len(paths):
            raise OptionError("LOG", [str(path) for path in paths], "files of different names, which a mapping tells")
        self._read: dict[Any, Log] = {}
        self._bags: dict[str, Bag] = {}
        self.notes: list[str] = []

    @property
    def used(self) -> list[Log]:
        """The logs that were read."""
        return list(self._read.values())

    def bag(self, name: str) -> Bag:
        """A bag, opened once."""
        if name not in self._bags:
            self._bags[name] = Bag(self.paths[name])
        return self._bags[name]

    def of(self, section: Section) -> Log:
        """The log of a section: the one it names, else the only one that has its columns; of constants a row of none.

        Raises
        ------
        GraphFileError
            No such log, several that have these columns; a log that cannot be read.
        """
        if not section.used:
            for option in ("file", "topic", "where", "rows"):
                given = section.options.get(option)
                if given is not None and given != section.mapping.tree.get(option):
                    log = given if option == "file" else "a log"
                    raise section.error(
                        option,
                        f"[{section.table}] uses no column of {log}; name one of its columns, or leave {option} out",
                    )
            return Log("", "", [], [], np.zeros(1, dtype=np.intp))
        named = section.options.get("file")
        if named is not None:
            if Path(named).name not in self.paths:
                near = did_you_mean(Path(named).name, self.paths)
                given = ", ".join(self.paths.values())
                raise section.error(
                    "file", f"{named!r} is not among the logs that are given{near or ';'} given: {given}"
                )
            return self._log(section, Path(named).name)
        if len(self.paths) == 1:
            return self._log(section, next(iter(self.paths)))
        if "topic" in section.options:
            bags = [name for name, path in self.paths.items() if is_bag(path)]
            candidates = [name for name in bags if section.options["topic"] in self.bag(name).topics] or bags
        else:
            candidates = [name for name, path in self.paths.items() if not is_bag(path)]
        logs = {name: self._log(section, name) for name in candidates}
        fitting = [name for name, log in logs.items() if set(section.used) <= set(log.names)]
        if len(fitting) == 1:
            self.notes.append(f"[{section.table}] is of {fitting[0]}, the only log with its columns")
            return logs[fitting[0]]
        if fitting:
            write = " or ".join(f'file = "{name}"' for name in fitting)
            raise section.error("", f"[{section.table}] may be of several logs; write {write}")
        if not logs:
            raise section.error("", f"[{section.table}] is of no log that is given; write file or topic")
        nearest = max(logs.values(), key=lambda log: sum(name in log.names for name in section.used))
        return nearest  # whose missing column is refused with the closest one

    def _log(self, section: Section, name: str) -> Log:
        """One log, read as the section says."""
        path = self.paths[name]
        if is_bag(path):
            topic = section.options.get("topic")
            bag = self.bag(name)
            if topic is None:
                raise section.error("", f"{name} is a bag; write topic = one of {', '.join(map(repr, bag.topics))}")
            if topic not in bag.topics:
                near = did_you_mean(topic, bag.topics) or ";"
                listed = ", ".join(map(repr, bag.topics))
                raise section.error("topic", f"{name} has no topic {topic!r}{near} it has {listed}")
            if (name, topic) not in self._read:
                self._read[name, topic] = bag.log(topic)
            return self._read[name, topic]
        if "topic" in section.options:
            raise section.error("topic", f"{name} is a text file and has no topics; leave topic out")
        how = {option: section.options[option] for option in READING if option in section.options}
        where = section.options.get("where")
        chosen = None if where is None else (str(where["column"]), str(where["equals"]))
        key = (name, *how.items(), chosen)
        if key not in self._read:
            try:
                self._read[key] = TextLog(path, where=chosen, **how)
            except GraphFileError as error:
                option = next((option for option in ("where", "join", "skip") if option in section.options), "")
                if not option or error.line is not None:
                    raise
                raise section.error(option, f"{error}; correct {option}") from error
        return self._read[key]
