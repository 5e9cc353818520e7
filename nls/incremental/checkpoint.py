"""A smoother as a file of named arrays, and back: equal to the bit, so that it continues as if it had never stopped.

Every object is an entry of a list that names its class, one of `STATE`; its attributes are numbers, texts, arrays or
places of entries before it. So nothing is made but what is listed here, and nothing is run. Factors of one sort stand
in one batch, as `joined` makes them, with the rows of each.

The file is an ``.npz`` archive of the arrays and of the text that names them, with the SHA-256 of both.
"""

from collections.abc import Callable, Hashable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from factors.base import Factor, Model
from factors.joined import bound_batch, form_of, sort_of
from factors.keys import Keys
from factors.robust import Kernel
from models import Manifold
from models.errors import GraphError, GraphFileError, LeadlineError
from nls.incremental.growing_arrays import Growing, GrowingBatch, Variables
from nls.incremental.growing_system import GrowingSystem
from nls.incremental.membership import Arrivals, Decision, Window
from nls.incremental.new_variables import Known
from nls.io.files import GZIP, ZIP, read_bytes, unreadable
from nls.io.native.data import KINDS, archived, arrays_of, json_of, plain_of, without_arrays
from nls.io.native.native import name_of_space, space_named
from nls.io.native.structure import MISMATCHES, Plain, decoded, encoded
from nls.linear.updatable import Preconditioner

FORMAT, VERSION = "leadline smoother", 4
STRUCTURE, CHECKSUM = "structure", "sha256"  # arrays that are texts
STATE = (Arrivals, Decision, Growing, GrowingBatch, GrowingSystem, Known, Preconditioner, Variables, Window)
MAKERS: dict[str, Callable[[Any], Any]] = {"float": float, "space": space_named, "thing": decoded}
HOLDERS: dict[str, Callable[[list[Any]], Any]] = {"list": list, "tuple": tuple, "set": set, "dict": dict}
S = TypeVar("S")


def smoother_bytes(smoother: object, about: Mapping[str, Any] | None = None) -> bytes:
    """The bytes of a smoother, and of what a program says about it.

    Raises
    ------
    GraphError
        A factor or a space that no file holds.
    """
    writer = _Writer(type(smoother))
    plain = {"format": FORMAT, "version": VERSION, "about": writer.of(about or {}), "smoother": writer.of(smoother)}
    arrays: dict[str, Any] = {}
    arrays[STRUCTURE] = np.array(json_of(without_arrays(plain | writer.tables(), arrays)))
    return archived({CHECKSUM: np.array(_checksum(arrays)), **arrays})


def read_smoother(path: str | Path, cls: type[S]) -> tuple[S, dict[str, Any]]:
    """The smoother of a file, and what was said about it.

    Parameters
    ----------
    path : the file.
    cls : `nls.Incremental`.

    Raises
    ------
    GraphFileError
        It is no such file, of another version, or damaged.
    """
    name = str(path)
    try:
        with open(path, "rb") as file:
            packed = file.read(len(ZIP)).startswith((ZIP, GZIP))
    except OSError as error:
        raise unreadable(path, error) from error
    arrays = arrays_of(read_bytes(path, archive=True), name, "checkpoint") if packed else {}
    if not {STRUCTURE, CHECKSUM} <= arrays.keys():
        raise GraphFileError("is no checkpoint; expected what nls.Incremental.save or nls stream wrote", name)
    if str(arrays.pop(CHECKSUM)) != _checksum(arrays):
        raise GraphFileError("is a damaged checkpoint: its checksum is that of other content", name)
    plain = plain_of(str(arrays.pop(STRUCTURE)), name, arrays)
    if not isinstance(plain, Mapping) or (plain.get("format"), plain.get("version")) != (FORMAT, VERSION):
        raise GraphFileError(f"is no checkpoint of this version, {FORMAT} {VERSION}; begin anew without it", name)
    try:
        reader = _Reader(plain, cls)
        smoother, about = reader.of(plain["smoother"]), reader.of(plain["about"])
        if not isinstance(smoother, cls) or not isinstance(about, dict):
            raise GraphError(f"it holds {type(smoother).__name__} and {type(about).__name__}")
        return smoother, about
    except (*MISMATCHES, LeadlineError) as error:
        raise GraphFileError(f"is no checkpoint: {error}; begin anew without it", name) from error


def _checksum(arrays: Mapping[str, Any]) -> str:
    """Of all arrays by name, the text among them."""
    whole = sha256()
    for name, array in arrays.items():
        whole.update(f"{name} {array.shape}".encode())
        whole.update(np.asarray(array, KINDS[array.dtype.kind]).tobytes())
    return whole.hexdigest()


class _Writer:
    """Entries of objects, and batches of factors; an object that is met again is the same entry."""

    def __init__(self, root: type[Any]) -> None:
        self._classes = (*STATE, root)
        self._entries: list[Plain] = []
        self._places: dict[int, tuple[int, Any]] = {}  # by `id`, with the thing: a free `id` would be given again
        self._factors: dict[int, tuple[int, Factor]] = {}  # the same of factors

    def of(self, thing: Any) -> Plain:
        """A whole number, text or truth as it is; of all else the place of its entry."""
        if thing is None or isinstance(thing, bool | int | str):
            return thing
        if id(thing) not in self._places:
            self._entries.append(self._entry(thing))
            self._places[id(thing)] = len(self._entries) - 1, thing
        return {"entry": self._places[id(thing)][0]}

    def _entry(self, thing: Any) -> Plain:
        if isinstance(thing, Model):
            return {"is": "model", "of": self._sequence([thing.factor])}
        if isinstance(thing, float):
            return {"is": "float", "of": str(thing)}
        if isinstance(thing, np.ndarray):
            return {"is": str(thing.dtype), "of": thing}
        if isinstance(thing, Manifold):
            return {"is": "space", "of": name_of_space(thing, "the smoother")}
        if isinstance(thing, Kernel | Keys):
            return {"is": "thing", "of": encoded(thing)}
        if (holder := type(thing).__name__) in HOLDERS:
            return {"is": holder, "of": self._sequence([*(thing.items() if holder == "dict" else thing)])}
        if type(thing) not in self._classes:
            raise GraphError(f"{thing!r:.60} cannot be stored in a checkpoint")
        return {"is": type(thing).__name__, "of": {k: self.of(value) for k, value in thing.__getstate__().items()}}

    def _sequence(self, items: list[Any]) -> Plain:
        """Items one by one; numbers, factors and arrays of one shape as an array, tuples of one length by columns."""
        types = {type(item) for item in items}
        if types == {int} or (types == {np.ndarray} and len({(item.shape, item.dtype) for item in items}) == 1):
            return {"rows": self.of(np.array(items))}
        if types == {tuple} and len({len(item) for item in items}) == 1 and items[0]:
            return {"columns": tuple(self._sequence([*column]) for column in zip(*items, strict=True))}
        if items and all(isinstance(item, Factor) for item in items):
            places = [self._factors.setdefault(id(item), (len(self._factors), item))[0] for item in items]
            return {"factors": np.array(places)}
        return {"items": tuple(map(self.of, items))}

    def tables(self) -> dict[str, Plain]:
        """Entries in order; batches of the factors of one sort; batch, begin and end (n, 3) of every factor."""
        sorts: dict[Hashable, dict[int, Factor]] = {}
        for k, factor in self._factors.values():
            sort: Hashable = k  # alone, where its spaces are not known
            if (model := factor._model) is not None and not factor.opaque:
                sort = model.manifolds, sort_of(factor), form_of(factor.noise), model.W.ndim
            sorts.setdefault(sort, {})[k] = factor
        rows, batches = np.zeros((len(self._factors), 3), dtype=np.int64), []
        for number, alike in enumerate(sorts.values()):
            factors = [*alike.values()]
            ends = np.cumsum([len(factor) for factor in factors])
            rows[[*alike]] = np.column_stack([np.full(len(ends), number), np.append(0, ends[:-1]), ends])
            spaces = None if (model := factors[0]._model) is None else tuple(map(str, model.manifolds))
            whole = factors[0] if len(alike) == 1 else bound_batch([f._model for f in factors if f._model is not None])
            batches.append({"factor": encoded(whole), "spaces": spaces})
        return {"batches": tuple(batches), "factors": rows, "entries": tuple(self._entries)}


class _Reader:
    """The objects of entries, and the factors of batches."""

    def __init__(self, plain: Mapping[str, Plain], root: type[Any]) -> None:
        self._classes: dict[str, type[Any]] = {cls.__name__: cls for cls in (*STATE, root)}
        batches = []
        for batch in plain["batches"]:
            batches.append(decoded(batch["factor"]))
            if batch["spaces"] is not None:
                batches[-1].bind(*map(space_named, batch["spaces"]))
        rows = plain["factors"].tolist()
        self._factors = [batches[k] if e - b == len(batches[k]) else batches[k][b:e] for k, b, e in rows]
        self._made: list[Any] = []
        for entry in plain["entries"]:
            self._made.append(self._object(entry["is"], entry["of"]))

    def of(self, plain: Plain) -> Any:
        """The thing that `_Writer.of` wrote."""
        return self._made[plain["entry"]] if isinstance(plain, Mapping) else plain

    def _object(self, kind: str, plain: Plain) -> Any:
        if isinstance(plain, np.ndarray):
            return plain.astype(kind)
        if kind == "model":
            return self._sequence(plain)[0]._model
        if kind in MAKERS:
            return MAKERS[kind](plain)
        if kind in HOLDERS:
            return HOLDERS[kind](self._sequence(plain))
        cls = self._classes[kind]
        made, state = object.__new__(cls), {name: self.of(value) for name, value in plain.items()}
        made.__setstate__(state) if hasattr(cls, "__setstate__") else vars(made).update(state)
        return made

    def _sequence(self, plain: Plain) -> list[Any]:
        ((kind, items),) = plain.items()
        if kind == "columns":
            return [*zip(*map(self._sequence, items), strict=True)]
        if kind == "factors":
            return [self._factors[k] for k in items.tolist()]
        if kind == "rows":
            return [row if row.ndim else int(row) for row in self.of(items)]
        return [*map(self.of, items)]
