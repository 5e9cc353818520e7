"""Options of the command line, read off the functions that make a world: names, types, defaults, meanings."""

from __future__ import annotations

import argparse
import inspect
import math
import re
import typing
from collections.abc import Callable
from typing import Any, NoReturn

from nls.cli.outputs import say

DIGITS = 18  # of a whole number: below 2^63
FLAGS = {"n_poses": "--poses"}  # other parameters of a world are options of their own name


class Parser(argparse.ArgumentParser):
    """One line for a mistake instead of the whole usage."""

    def error(self, message: str) -> NoReturn:
        say(f"nls-sim: {message}; see {self.prog} --help", error=True)
        raise SystemExit(2)


def parameters(make: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """The parameters that are options: all but the generator, and those that Python alone can give, by keyword."""
    signature = inspect.signature(make).parameters
    positional = inspect.Parameter.POSITIONAL_OR_KEYWORD
    return {
        option: parameter
        for option, parameter in signature.items()
        if parameter.default is not parameter.empty and parameter.kind is positional
    }


def add_parameters(sub: argparse.ArgumentParser, make: Callable[..., Any], unset: bool = False) -> None:
    """An option for each parameter; unset: what is not given is not there, in the place of its default."""
    described = re.findall(r"^(\w+) : (.+(?:\n +.+)*)", inspect.getdoc(make) or "", re.MULTILINE)
    helps = {name: " ".join(text.split()) for name, text in described}
    hints = typing.get_type_hints(make)
    for option, parameter in parameters(make).items():
        default = parameter.default
        shown = f"{default:.4g}" if hints[option] is float else default
        hint = "" if default is None or default is False else f" (default {shown})"
        sub.add_argument(
            flag(option),
            dest=option,
            default=argparse.SUPPRESS if unset else default,
            help=(helps[option].rstrip(".") + hint).replace("`", "").replace("%", "%%"),
            **values_of(hints[option]),
        )


def add_outputs(sub: argparse.ArgumentParser, written: str) -> None:
    """The options of every command: its seed and its folder."""
    sub.add_argument("--seed", type=seed_number, default=0, metavar="N", help="of the random numbers (default 0)")
    sub.add_argument("--out", metavar="DIR", help=f"write {written} and README.txt into this folder")


def command(name: str, seed: int, arguments: dict[str, Any]) -> str:
    """The command that makes the same again, with every option spelled out."""
    words = [f"nls-sim {name} --seed {seed}"]
    for option, value in arguments.items():
        if isinstance(value, list | tuple):
            words.append(f"{flag(option)} {' '.join(map(str, value))}")
        elif value is not None and value is not False:
            words.append(flag(option) if value is True else f"{flag(option)} {value}")
    return " ".join(words)


def values_of(hint: Any) -> dict[str, Any]:
    """Arguments for argparse of a parameter with this type: words, a number or a whole number."""
    if hint is bool:
        return {"action": "store_true"}
    if typing.get_origin(hint) is typing.Literal:
        return {"choices": typing.get_args(hint)}
    return {"type": number, "metavar": "X"} if hint is float else {"type": whole_number, "metavar": "N"}


def flag(option: str) -> str:
    """The option of the command line that sets a parameter."""
    return FLAGS.get(option, "--" + option.replace("_", "-")) if option.isidentifier() else option


def whole_number(text: str) -> int:
    """An int, or the sentence argparse prints."""
    if not re.fullmatch(r"[+-]?[0-9]+", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    if len(text.lstrip("+-")) > DIGITS:
        raise argparse.ArgumentTypeError(f"{text!r} is too large; a whole number has at most {DIGITS} digits here")
    return int(text)


def seed_number(text: str) -> int:
    """A whole number of at least 0."""
    if (value := whole_number(text)) < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is below 0; a seed is a whole number of at least 0")
    return value


def number(text: str) -> float:
    """A float, in radians where it ends in deg, or the sentence argparse prints."""
    if not re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?(deg)?", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return math.radians(float(text[:-3])) if text.endswith("deg") else float(text)
