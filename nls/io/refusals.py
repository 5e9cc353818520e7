"""Why a graph text file cannot hold a factor, and which file can: one refusal for all formats."""

from __future__ import annotations

from factors.base import Factor
from factors.bearing_range import BearingRange
from factors.range import Range
from models.advice import Advice
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.io.native.structure import type_name
from nls.io.records import at_origin, fixed_offsets

NATIVE = Advice("native")


def unwritable(path: str, factor: Factor, file: str, why: str = "", ranges: bool = False) -> GraphError:
    """The error for a factor that a format has no line for.

    Parameters
    ----------
    path : the file.
    factor : the factor.
    file : of which format it would be, such as ``a g2o file``.
    why : the cause, where the format knows it.
    ranges : whether the format has lines for ranges.
    """
    if not why and isinstance(factor, BearingRange):
        why = "no line holds a bearing and its range, and two lines would be two independent measurements"
    advice = other_files(factor)
    if type(factor) is Range and not ranges and len(factor.keys) == 2 and at_origin(fixed_offsets(factor)):
        advice = [Advice("pyfg"), *advice]
    message = f"{path}: {factor!r} cannot be written to {file}" + (f": {why}" if why else "")
    return GraphError(message, factor.keys, factor.name, advice=advice)


def refuse_held(path: str, graph: FactorGraph, file: str) -> None:
    """Refuse variables that are held fixed, for a format that has no line for it.

    Raises
    ------
    GraphError
    """
    if held := [keys for keys in graph.fixed if len(keys)]:
        message = f"{path}: {held[0]!r} is held fixed, which {file} has no line for"
        raise GraphError(message, held, advice=[NATIVE])


def other_files(factor: Factor) -> list[Advice]:
    """The files that hold a factor: native ones hold all that have a name there."""
    return [NATIVE if type_name(factor) is not None else Advice("register")]


def named(path: str, factor: Factor, error: GraphError) -> GraphError:
    """The refusal of what a factor holds, with the file."""
    return GraphError(f"{path}: {error.message}", factor.keys, factor.name, advice=error.advice or other_files(factor))
