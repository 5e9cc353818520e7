"""A graph and its values as a native file, and back; the format is on the page on files."""

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from factors.base import Factor
from factors.keys import Keys, Kind
from models import LINE, S2, SE2, SE3, SO2, SO3, Manifold, Measured, R
from models.errors import GraphError, GraphFileError, LeadlineError
from models.listing import some
from nls.gauge import fixed_variables
from nls.graph import FactorGraph, Singles
from nls.io.files import ZIP
from nls.io.native.data import archived, arrays_of, json_of, plain_of, without_arrays
from nls.io.native.structure import MISMATCHES, decoded, encoded
from nls.io.report import LoadReport, Source
from nls.values import Values

FORMAT, VERSION = "leadline graph", 1
PARTS = ("values", "fixed", "factors")
STRUCTURE = "structure"  # the array of an archive that says what the others are
GTSAM = "keys of GTSAM"  # what the ids of a kind were in the file that it was read from
SPACES = {space.name: space for space in (SO2, SE2, SO3, SE3, S2, LINE)}
VECTORS = re.compile(r"R\(([1-9][0-9]{0,4})\)")
MEASURED = re.compile(r"\(([^(),]+(?:, [^(),]+){0,99})\)")


def native_bytes(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """The bytes of a native file, and no notes.

    Parameters
    ----------
    path : for messages.
    form : ``npz`` or ``json``.
    graph, values : what to write.
    report : of the file that the graph was read from, whose times of poses and keys of GTSAM are kept.

    Raises
    ------
    GraphError
        A factor or a space that the file does not hold.
    """
    times = {} if report is None else report.vertex_times
    stacks: dict[str, Any] = {}
    for kind, stack in values.stacks.items():
        space = name_of_space(stack.manifold, f"{path}: {kind}")
        stacks[kind] = {"space": space, "numbers": stack.numbers, "X": stack.X}
        if kind in times:
            stacks[kind]["times"] = np.asarray(times[kind])
        if report is not None and kind in report.gtsam_kinds:
            stacks[kind]["ids"] = GTSAM
    fixed_variables(graph.fixed, values)  # refuses one without a value
    numbers: dict[str, list[Any]] = {}
    for keys in graph.fixed:
        numbers.setdefault(keys.kind, []).append(keys.numbers)
    plain = {
        "format": FORMAT,
        "version": VERSION,
        "values": stacks,
        "fixed": {kind: np.unique(np.concatenate(n)) for kind, n in numbers.items()},
        "factors": {str(k): encoded(factor) for k, factor in enumerate(graph.factors)},
    }
    if form == "json":
        return (json_of(plain) + "\n").encode(), []
    arrays: dict[str, Any] = {}
    return archived({STRUCTURE: np.array(json_of(without_arrays(plain, arrays))), **arrays}), []


def read_native(data: bytes, path: str) -> tuple[FactorGraph, Values, LoadReport]:
    """Graph, values and report of the bytes of a native file.

    Raises
    ------
    GraphFileError
        It is damaged, of a later version, or holds what no graph can be; says where.
    ResourceLimitError
        It claims to unpack to far more than its size.
    """
    arrays: dict[str, Any] = {}
    if data.startswith(ZIP):
        arrays = arrays_of(data, path)
        if STRUCTURE not in arrays or arrays[STRUCTURE].shape or arrays[STRUCTURE].dtype.kind != "U":
            raise GraphFileError(f"has no text {STRUCTURE!r}: it was not written by nls.save", path)
        text, form = str(arrays.pop(STRUCTURE)), "npz"
    else:
        text, form = data.decode("utf-8", "replace"), "json"
    plain = plain_of(text, path, arrays)
    if not isinstance(plain, Mapping) or not isinstance(plain.get("format"), str) or plain["format"] != FORMAT:
        raise GraphFileError(f"does not say that its format is {FORMAT!r}", path)
    version = plain.get("version")
    if type(version) is not int or version != VERSION:
        raise GraphFileError(f"has version {version!r:.20}, this library reads {VERSION}; update it", path)
    for name in PARTS:
        if not isinstance(plain.get(name), Mapping):
            raise GraphFileError(f"its {name} are missing", path)
    _refuse_others(plain, {"format", "version", *PARTS}, "the file", path)
    report = LoadReport(path, form, "", "", reason=f"it says that it is a {FORMAT}")
    values = _values(plain["values"], path, report)
    factors = [_factor(item, name, values, path) for name, item in plain["factors"].items()]
    if all(keys.kind in values.stacks for factor in factors for keys in factor.keys):
        factors = Singles().joined(factors, values)  # as they would be when the graph is evaluated
    fixed = [_checked(path, "fixed", Keys, kind, numbers) for kind, numbers in plain["fixed"].items()]
    _checked(path, "fixed", fixed_variables, fixed, values)
    report.convention = ", ".join(dict.fromkeys(factor.convention for factor in factors))
    spaces = {stack.manifold for stack in values.stacks.values()}
    report.dimension = "3-D" if spaces & {SE3, SO3, R(3)} else "2-D"
    report.tags = dict(Counter(factor.name for factor in factors for _ in range(len(factor))))
    report.sources = [Source(path, np.zeros(len(factor), dtype=np.intp)) for factor in factors]  # no lines
    if arrays:
        report.notes.append(f"{some([repr(name) for name in arrays], noun=' arrays')}: of no use for a graph")
    return FactorGraph(factors, fixed), values, report


def name_of_space(space: Manifold, subject: str) -> str:
    """The name of a space, under which `space_named` finds it.

    Raises
    ------
    GraphError
        The library does not have it; the subject, what is in it, begins the message.
    """
    if space_named(name := str(space)) is not space:
        raise GraphError(f"{subject} is in {name}, a space of your own, which no file holds")
    return name


def space_named(name: object) -> Manifold | None:
    """The space of a name; None where the library has none."""
    if not isinstance(name, str):
        return None
    if vectors := VECTORS.fullmatch(name):
        return R(int(vectors[1]))
    if (measured := MEASURED.fullmatch(name)) and len(set(names := measured[1].split(", "))) == len(names):
        return Measured(*names)
    return SPACES.get(name)


def _values(stacks: Mapping[str, Any], path: str, report: LoadReport) -> Values:
    """The values of a file; their times go into the report."""
    values = Values()
    for kind, stack in stacks.items():
        if not isinstance(stack, Mapping) or not {"space", "numbers", "X"} <= stack.keys():
            raise GraphFileError(f"values of {kind!r:.30}: expected a space, numbers and X", path)
        _refuse_others(stack, {"space", "numbers", "X", "times", "ids"}, f"values of {kind!r:.30}", path)
        arrays = [stack[name] for name in {"numbers", "X", "times"} & stack.keys()]
        if not all(isinstance(array, np.ndarray) and array.dtype.kind in "if" for array in arrays):
            raise GraphFileError(f"values of {kind!r:.30}: expected arrays of numbers", path)
        if (space := space_named(stack["space"])) is None:
            raise GraphFileError(f"values of {kind!r:.30}: {stack['space']!r:.30} is no space of this library", path)
        _checked(path, f"values of {kind!r:.30}", _add, values, kind, space, stack["X"], stack["numbers"])
        if "times" in stack:
            times = stack["times"]
            if times.dtype.kind != "f" or times.shape != (len(values.stack(kind)),) or not np.isfinite(times).all():
                raise GraphFileError(f"values of {kind!r:.30}: expected a time for each, in s", path)
            report.vertex_times[kind] = times
        if "ids" in stack:
            if not isinstance(stack["ids"], str) or stack["ids"] != GTSAM:
                raise GraphFileError(f"values of {kind!r:.30}: ids are {GTSAM!r}, or the entry is missing", path)
            report.gtsam_kinds += (kind,)
    return values


def _refuse_others(entries: Mapping[str, Any], known: set[str], where: str, path: str) -> None:
    """Refuse an entry that would be lost."""
    if others := sorted(entries.keys() - known):
        raise GraphFileError(f"{where}: {others[0]!r:.30} is no entry here; expected {', '.join(sorted(known))}", path)


def _add(values: Values, kind: str, space: Manifold, X: Any, numbers: Any) -> None:
    values.add(Kind(kind), space, X.astype(float) if X.size else np.zeros((0, space.size)), numbers)


def _factor(item: Any, name: str, values: Values, path: str) -> Factor:
    """A factor of a file, bound where all of its variables have a space."""
    kind = item.get("type") if isinstance(item, Mapping) else None
    where = f"factor {name!s:.20} ({kind!s:.40})"
    factor = _checked(path, where, decoded, item)
    if not isinstance(factor, Factor):
        raise GraphFileError(f"{where} is no factor", path)
    if not len(factor) and factor.z.size:
        raise GraphFileError(f"{where}: its measurements z are of no variables", path)
    if all(keys.kind in values.stacks for keys in factor.keys):
        _checked(path, where, factor.bind, *(values.stack(keys.kind).manifold for keys in factor.keys))
    return factor


def _checked(path: str, where: str, make: Any, *arguments: Any) -> Any:
    """The result of a function of a part of the file; its refusal says where."""
    try:
        return make(*arguments)
    except LeadlineError as error:
        raise GraphFileError(f"{where}: {error}", path) from error
    except MISMATCHES as error:
        raise GraphFileError(f"{where}: cannot be used: {error}", path) from error
