"""Keys of GTSAM: a letter and a number in one id of 64 bits, ``c << 56 | k``; a second letter, the label, at bit 48.

A vertex 6989586621679009836 is a44, number 44 of kind ``a``: the poses of robot a. With a label B it is aB44. Plain ids
beside them keep their kinds. An id that is neither leaves all as numbers, and so does one name for two things. The
*head* of an id are its letter and label, the 16 bits from bit 48: 0 of a plain number, -1 of neither.

Source: F. Dellaert and the GTSAM contributors, GTSAM 4, gtsam/inference/Symbol.h and LabeledSymbol.h.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from string import ascii_letters

import numpy as np

from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, R
from models.algebra import Mask, Numbers
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.io.lines import different
from nls.io.records import KINDS
from nls.io.report import LoadReport
from nls.values import Stack, Values

__all__ = ["VertexIds", "id_text", "with_letters"]

BITS = 48  # of the number of a key
PLAIN = 1 << 56  # ids below have no letter
LETTERS = list(ascii_letters.encode())
SPACES = {SE2: "pose", SE3: "pose", R(2): "point", R(3): "point"}


def with_letters(
    graph: FactorGraph, values: Values, report: LoadReport, ids: Mapping[str, Numbers]
) -> tuple[FactorGraph, Values, LoadReport]:
    """A graph as read, its variables named by the letters and numbers of their keys; as it is where there are none.

    Parameters
    ----------
    graph, values, report : as read, the numbers of variables their ids.
    ids : of all vertices, by kind.
    """
    heads = [(kind, head) for kind, n in ids.items() for head in different(_heads(n)).tolist()]
    letters = tuple(_name(*pair) for pair in heads if pair[1] > 0)
    if not letters:
        return graph, values, report
    names = [_name(*pair) for pair in heads]
    odd = ["others are neither that nor below 2^56"] * any(head < 0 for _, head in heads)
    odd += [f"{name} would be two kinds" for name in letters if names.count(name) > 1]
    if odd:
        report.notes.append(f"ids look like keys of GTSAM ({', '.join(letters)}), and are kept as numbers: {odd[0]}")
        return graph, values, report
    report.notes.append(f"ids are keys of GTSAM, a letter and a number in one: kinds {', '.join(letters)}")
    parts = [
        (k, mine, replaced(factor if mine.all() else factor[mine], keys))
        for k, factor in enumerate(graph.factors)
        for mine, keys in _parts(*factor.keys)
    ]
    stacks = []
    for stack in values.stacks.values():
        for mine, (key,) in _parts(Keys(stack.kind, stack.numbers if len(stack) else ids[stack.kind])):
            X = stack.X[mine] if len(stack) else stack.X
            stacks.append(Stack(key.kind, stack.manifold, X, key.numbers[: len(X)]))
    fixed = [key for keys in graph.fixed for _, (key,) in _parts(keys)]
    report = replace(report.of_parts(graph.factors, parts), gtsam_kinds=letters)
    return FactorGraph([part for _, _, part in parts], fixed), Values.of(stacks), report


def id_text(number: int) -> str:
    """An id in words, with its name where it is a key.

    Examples
    --------
    >>> id_text(17), id_text(ord("b") << 56 | 2)
    ('17', 'b2 (7061644215716937730)')
    """
    ((_, (key,)),) = _parts(Keys("", [number]))
    return f"{key!r} ({number})" if key.kind else str(number)


class VertexIds:
    """How the variables of a graph stand in a graph text file.

    Kinds x, l and o are poses, points and places of sensors with plain ids, unless the graph was read with keys of
    these letters. Other kinds of one or two letters have keys, and are what their space and their use says.

    Parameters
    ----------
    graph, values, report : as for `nls.save`.

    Attributes
    ----------
    roles : ``pose``, ``point`` or ``mount``, by kind; of kinds that have one.
    keyed : kinds whose ids are keys.
    """

    def __init__(self, graph: FactorGraph, values: Values, report: LoadReport | None) -> None:
        self.roles = {kind: role for role, kind in KINDS.items()}
        plain = set(self.roles) - set(() if report is None else report.gtsam_kinds)
        mounts = {factor.keys[slot].kind for factor in graph.factors for slot in factor.unmoved}
        spaces = {s.kind: SPACES[s.manifold] for s in values.stacks.values() if s.manifold in SPACES}
        self.keyed = {
            kind for kind in spaces if kind not in plain and kind.isascii() and kind.isalpha() and len(kind) < 3
        }
        for kind in sorted(self.keyed):
            self.roles[kind] = "mount" if spaces[kind] == "pose" and kind in mounts else spaces[kind]

    def of(self, keys: Keys) -> Numbers:
        """Ids (n,) of variables.

        Raises
        ------
        GraphError
            A number that a key has no room for.
        """
        if keys.kind not in self.keyed:
            return keys.numbers
        if len(wrong := keys[(keys.numbers < 0) | (keys.numbers >> BITS > 0)]):
            raise GraphError(f"{wrong[[0]]!r} is no key of GTSAM: its number must be from 0 to 2^48 - 1", [wrong])
        letter, label = (keys.kind + "\0").encode()[:2]
        return keys.numbers | (letter << 8 | label) << BITS


def _heads(ids: Numbers) -> Numbers:
    """Head (n,) of every id."""
    head = ids >> BITS
    is_key = np.isin(head >> 8, LETTERS) & np.isin(head & 255, [0, *LETTERS])
    return np.where(is_key, head, np.where(ids < PLAIN, 0, -1))


def _name(kind: str, head: int) -> str:
    """The kind of the ids of a head, plain ones of this kind.

    Examples
    --------
    >>> _name("x", 0), _name("x", ord("a") << 8), _name("x", ord("a") << 8 | ord("B"))
    ('x', 'a', 'aB')
    """
    return bytes([head >> 8, head & 255]).decode().rstrip("\0") if head > 0 else kind


def _parts(*slots: Keys) -> Iterator[tuple[Mask, list[Keys]]]:
    """For every combination of heads in these slots, which rows (n,) have it, and their variables."""
    heads = np.stack([_heads(keys.numbers) for keys in slots])
    _, first, of = np.unique(heads, axis=1, return_index=True, return_inverse=True)
    for k in np.argsort(first):
        mine = of.reshape(-1) == k
        combination = zip(slots, heads[:, first[k]].tolist(), strict=True)
        yield mine, [Keys(_name(s.kind, head), s.numbers[mine] - (head << BITS)) for s, head in combination]
