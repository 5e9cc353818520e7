"""A finding as a value: a kind, numbers, advice. The table of the room that owns the kind makes a sentence of it.

A room registers the file that has its sentences under its own kinds, so no room imports one above it for words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, is_dataclass
from enum import Enum
from importlib import import_module
from string import Formatter
from typing import TYPE_CHECKING, Any

from models.finite import finite_or_none
from models.listing import number, some

__all__ = ["Numbered", "Sentences", "Stated", "plain", "register"]

FORMS: dict[str, Callable[[Any], Any]] = {"n": number, "l": some, "p": lambda part: 100 * part}  # a part in percent
Sentences = Mapping[Enum, str | Callable[[Any], str]]  # a text with numbers in braces, or a function of the finding
_TABLES: dict[tuple[type[Enum], Enum], str] = {}  # the file of sentences of every kind


class Stated:
    """A finding of any room: a frozen dataclass, whose kind is registered.

    Attributes
    ----------
    kind : member of an enumeration, the identifier that programs get.
    numbers : by name.
    keys : the variables it is about; none of most.
    """

    if TYPE_CHECKING:  # a field, or a property

        @property
        def kind(self) -> Enum: ...
        @property
        def numbers(self) -> Mapping[str, Any]: ...

    keys: tuple[Any, ...] = ()

    @property
    def says(self) -> str:
        """The finding in a sentence.

        Raises
        ------
        LookupError
            No imported room has registered the kind.
        """
        kind = self.kind
        if (table := _TABLES.get((type(kind), kind))) is None:
            raise LookupError(f"{kind!r} has no sentence yet; import the room of such findings, as nls.missions.checks")
        words: str | Callable[[Any], str] = import_module(table).SENTENCES[kind]
        if callable(words):
            return words(self)
        return _Words().vformat(words, self.keys, {"keys": self.keys, **self.numbers})

    def record(self) -> dict[str, Any]:
        """The finding for programs, and in words."""
        return {**plain(self), "sentence": self.says}


class Numbered(Stated):
    """A finding whose numbers are its fields."""

    @property
    def numbers(self) -> Mapping[str, Any]:
        """Fields by name."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]


class _Words(Formatter):
    """Texts with the numbers of a finding, its variables by place, and the conversions of `FORMS`."""

    def convert_field(self, value: Any, conversion: Any) -> Any:
        return FORMS[conversion](value) if conversion in FORMS else super().convert_field(value, conversion)


def register(table: str, *kinds: Enum) -> None:
    """Say which file has the sentences of some kinds.

    Parameters
    ----------
    table : a module, imported when the first sentence is wanted. Its `SENTENCES` has a text with the numbers of the
        finding in braces, or a function of the finding, for every kind.
    kinds : of findings.

    Examples
    --------
    A text formats numbers, and three ways more: ``!n`` a number, ``!l`` a list, ``!p`` a part in percent.

    >>> _Words().format("{0!r}: {chi2!n}, {part!p:.2g} % of {names!l}", "x0", chi2=4e4, part=0.5, names=["a", "b"])
    "'x0': 40,000, 50 % of a, b"
    """
    _TABLES.update({(type(kind), kind): table for kind in kinds})


def plain(value: Any) -> Any:
    """A value for programs: fields by name, kinds and variables by theirs, None for a number that is not finite.

    Examples
    --------
    >>> from models.advice import Advice
    >>> plain({"advice": (Advice("fix", ("x0",)),), "sigmas": float("inf")})
    {'advice': [{'action': 'fix', 'about': ['x0']}], 'sigmas': None}
    """
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return finite_or_none(value) if isinstance(value, str | int | float | None) else repr(value)
