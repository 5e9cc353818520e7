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

FORMAT, VERSION = "leadline smoother", 3
STRUCTURE, CHECKSUM = "structure", "sha256"  # arrays that are texts
STATE = (Arrivals, Decision, Growing, GrowingBatch, GrowingSystem, Known, Preconditioner, Variables, Window)
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
    structure = json_of(without_arrays(plain | writer.tables(), arrays))
    texts = {STRUCTURE: np.array(structure), CHECKSUM: np.array(_checksum(structure, arrays))}
    return archived({**texts, **arrays})


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
    structure, checksum = (str(arrays.pop(text)) for text in (STRUCTURE, CHECKSUM))
    if _checksum(structure, arrays) != checksum:
        raise GraphFileError("is a damaged checkpoint: its checksum is that of other content", name)
    plain = plain_of(structure, name, arrays)
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


def _checksum(structure: str, arrays: Mapping[str, Any]) -> str:
    """Of the text and of all arrays by name."""
    whole = sha256(structure.encode())
    for name, array in arrays.items():
        whole.update(f"{name} {array.shape}".encode())
        whole.update(np.asarray(array, KINDS[array.dtype.kind]).tobytes())
    return whole.hexdigest()


class _Writer:
    """Entries of objects, and batches of factors; an object that is met again is the same entry."""

    def __init__(self, root: type[Any]) -> None:
        self._classes = (*STATE, root)
        self._entries: list[Plain] = []
        # places and things by `id`: held here, as an `id` that is free would be given again
        self._places: dict[int, tuple[int, Any]] = {}
        self._factors: dict[int, tuple[int, Factor]] = {}

    def of(self, thing: Any) -> Plain:
        """A whole number, text or truth as it is; of all else the place of its entry."""
        if thing is None or isinstance(thing, bool | int | str):
            return thing
        if isinstance(thing, float):
            return {"float": str(thing)}
        if isinstance(thing, Model):
            return {"model": self._factor(thing.factor)}
        if isinstance(thing, Factor):
            return {"factor": self._factor(thing)}
        if id(thing) not in self._places:
            self._entries.append(self._entry(thing))
            self._places[id(thing)] = len(self._entries) - 1, thing
        return {"entry": self._places[id(thing)][0]}

    def _factor(self, factor: Factor) -> int:
        return self._factors.setdefault(id(factor), (len(self._factors), factor))[0]

    def _entry(self, thing: Any) -> Plain:
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
        state = {name: self.of(value) for name, value in thing.__getstate__().items()}
        return {"is": type(thing).__name__, "of": state}

    def _sequence(self, items: list[Any]) -> Plain:
        """Items one by one; whole numbers, arrays of one shape, factors and tuples of one length as arrays."""
        types = {type(item) for item in items}
        if types == {int} or (types == {np.ndarray} and len({(item.shape, item.dtype) for item in items}) == 1):
            return {"rows": self.of(np.array(items))}
        if types == {tuple} and len({len(item) for item in items}) == 1 and items[0]:
            return {"columns": tuple(self._sequence([*column]) for column in zip(*items, strict=True))}
        if items and all(isinstance(item, Factor) for item in items):
            return {"factor": np.array([self._factor(item) for item in items])}
        return {"items": tuple(map(self.of, items))}

    def tables(self) -> dict[str, Plain]:
        """Entries in order; batches of the factors of one sort; batch, begin and end (n, 3) of every factor."""
        in_order = [factor for _, factor in self._factors.values()]
        sorts: dict[Hashable, list[int]] = {}
        for k, factor in enumerate(in_order):
            sort: Hashable = k  # alone, where its spaces are not known
            if (model := factor._model) is not None and not factor.opaque:
                sort = model.manifolds, sort_of(factor), form_of(factor.noise), model.W.ndim
            sorts.setdefault(sort, []).append(k)
        rows, batches = np.zeros((len(in_order), 3), dtype=np.int64), []
        for number, alike in enumerate(sorts.values()):
            factors = [in_order[k] for k in alike]
            ends = np.cumsum([len(factor) for factor in factors])
            rows[alike] = np.column_stack([np.full(len(ends), number), np.append(0, ends[:-1]), ends])
            models = [factor._model for factor in factors if factor._model is not None]
            spaces = tuple(map(str, models[0].manifolds)) if models else None
            whole = factors[0] if len(factors) == 1 else bound_batch(models)
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
        factors = [batches[k] if e - b == len(batches[k]) else batches[k][b:e] for k, b, e in rows]
        self._made: dict[str, list[Any]] = {"factor": factors, "model": [f._model for f in factors], "entry": []}
        for entry in plain["entries"]:
            self._made["entry"].append(self._object(entry["is"], entry["of"]))

    def of(self, plain: Plain) -> Any:
        """The thing that `_Writer.of` wrote."""
        if not isinstance(plain, Mapping):
            return plain
        ((kind, value),) = plain.items()
        return float(value) if kind == "float" else self._made[kind][value]

    def _object(self, kind: str, plain: Plain) -> Any:
        if isinstance(plain, np.ndarray):
            return plain.astype(kind)
        if kind == "space":
            return space_named(plain)
        if kind == "thing":
            return decoded(plain)
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
        if kind == "factor":
            return [self._made[kind][k] for k in items.tolist()]
        if kind == "items":
            return [*map(self.of, items)]
        rows = self.of(items)
        return rows.tolist() if rows.ndim == 1 else [*rows]
